"""Projection of points and lines from the world to the image, shared by all fits and tools.

Source: Hartley and Zisserman, section 6.1.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics.buckets import in_bucket
from trinoc.numerics.precision import ArrayLike, NumpyOrTraced, array_namespace, is_traced
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.vectors import (
    Scalar,
    Vector2,
    Vector3,
    dot3,
    vector3,
)


class Projection(NamedTuple):
    """Undistorted pixels of points with their depths and derivatives.

    Attributes
    ----------
    uv_px : (..., 2)
        Pixel of each point.
    depth : (...)
        Depth z in the camera frame, positive in front of the camera. In mm if the third row of the
        projection matrix has a left part of unit length.
    by_point : (..., 2, 3)
        Derivative of the pixel by the coordinates of the point, px/mm.
    """

    uv_px: Float[NumpyOrTraced, "*n 2"]
    depth: Float[NumpyOrTraced, "*n"]
    by_point: Float[NumpyOrTraced, "*n 2 3"]


def project_point(
    pose: Pose, lens: AbstractLens, point_world_mm: Float[ArrayLike, "3"]
) -> Float[ArrayLike, "2"]:
    """Pixel (2,) that images a world point through a lens. Usable inside `jit`, `grad` and `vmap`.

    Meaningless for a point that the lens cannot image, for example behind a pinhole camera.
    """
    return lens.project_ray(pose.transform(point_world_mm))


def project_by_matrix(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Float[NumpyOrTraced, "*e 2"]:
    """Undistorted pixels of world points, by projection matrices.

    Parameters
    ----------
    matrix_px : (*m, 3, 4)
        One projection matrix, or several.
    points_world_mm : (3,), (e, 3) or (*m, e, 3)
        Points in the world frame; e points for each matrix. Leading axes *m broadcast.

    Returns
    -------
    (..., 2)
        Pixels. A NumPy array if both arguments are NumPy arrays.
    """
    image = homogeneous_pixel(matrix_px, points_world_mm)
    return image[..., :2] / image[..., 2:]


def project_with_jacobian(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Projection:
    """Project world points: undistorted pixels, depths, and derivatives of pixels by points.

    The arguments are those of `project_by_matrix`: one matrix or several, with e points for each.
    """
    image = homogeneous_pixel(matrix_px, points_world_mm)
    uv, depth = image[..., :2] / image[..., 2:], image[..., 2]
    rows: Any = matrix_px if points_world_mm.ndim == 1 else matrix_px[..., None, :, :]
    by_point = rows[..., :2, :3] - uv[..., None] * rows[..., 2:, :3]
    by_point = by_point / depth[..., None, None]
    return Projection(uv, depth, by_point)


def homogeneous_pixel(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Any:
    """Homogeneous undistorted pixels (u w, v w, w) of world points, (..., 3); w is the depth.

    The arguments are those of `project_by_matrix`.
    """
    if is_traced(matrix_px, points_world_mm) and matrix_px.ndim > 2:
        # Sums of products and no products of matrices, which XLA computes one by one.
        rows = matrix_px[..., None, :, :]
        return (rows[..., :3] * points_world_mm[..., None, :]).sum(-1) + rows[..., 3]
    matrix: Any = matrix_px
    offset = matrix[..., 3] if points_world_mm.ndim == 1 else matrix[..., None, :, 3]
    return points_world_mm @ matrix[..., :3].mT + offset


def image_of_point(
    matrix_px: Float[ArrayLike, "... 3 4"], point: Vector3
) -> tuple[Vector2, Scalar]:
    """Undistorted pixels and depths of points whose coordinates are separate arrays.

    Returns ((u, v), depth). The compiler XLA fuses operations on separate coordinate arrays.
    """
    u, v, depth = (
        dot3(vector3(matrix_px[..., k, :3]), point) + matrix_px[..., k, 3] for k in range(3)
    )
    return (u / depth, v / depth), depth


def pixel_change(uv_px: Vector2, depth: Scalar, change: Vector3) -> Vector2:
    """First-order change (du, dv) of a pixel for a change of its homogeneous coordinates.

    `depth` is the third homogeneous coordinate of the pixel.
    """
    u, v = uv_px
    return (change[0] - u * change[2]) / depth, (change[1] - v * change[2]) / depth


def project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """Project world points through a lens, with NaN for points that the lens cannot image.

    Parameters
    ----------
    pose : Pose
        Pose of the camera, cam_from_world.
    lens : AbstractLens
        Lens.
    points_world_mm : (n, 3)
        Points in the world frame.

    Returns
    -------
    (n, 2)
        Pixels; NaN beyond the fold of the lens.

    Notes
    -----
    Not usable inside `jit`. Arrays are padded to one of a few lengths, because each length is
    compiled once.
    """
    uv_px = in_bucket(partial(_project_points, pose, lens), points_world_mm)
    return mask_folded(pose, lens, points_world_mm, uv_px)


def mask_folded(
    pose: Pose,
    lens: AbstractLens,
    points_world_mm: Float[ArrayLike, "*n 3"],
    uv_px: Float[ArrayLike, "*n 2"],
) -> Any:
    """Replace pixels by NaN if their world points lie beyond the fold of the lens.

    Inside `jit` the pixels are returned unchanged, because the fold is not computed there.
    """
    if is_traced(pose, lens) or lens.valid_radius_px() == np.inf:
        return uv_px
    pose_mm = np.asarray(pose.cam_from_world)
    return lens.mask_ray(points_world_mm @ pose_mm[:, :3].T + pose_mm[:, 3], uv_px)


def unproject_pixels(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Unit rays (n, 3) of pixels, in the camera frame.

    Arrays are padded to one of a few lengths, because each length is compiled once.
    """
    return in_bucket(partial(_unproject_pixels, lens), uv_px)


@kept_jit
def _project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(partial(project_point, pose, lens))(points_world_mm)


@kept_jit
def _unproject_pixels(
    lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(lens.unproject)(uv_px)


class LineDistances(NamedTuple):
    """Signed distances of image points from the image of a 3-D line, with derivatives.

    Attributes
    ----------
    distance_px : (*m, e)
        Positive for a point on the right of the direction from the first to the second end of the
        line, as displayed (v down).
    by_ends : (*m, e, 2, 3)
        Derivative of the distance by the ends of the line, px/mm.
    """

    distance_px: Float[NumpyOrTraced, "*m e"]
    by_ends: Float[NumpyOrTraced, "*m e 2 3"]


def distances_from_line(
    matrix_px: Float[ArrayLike, "*m 3 4"],
    ends_mm: Float[ArrayLike, "*n 2 3"],
    points_px: Float[ArrayLike, "*m e 2"],
) -> LineDistances:
    """Signed distances of image points from the image of the line through two 3-D points.

    Parameters
    ----------
    matrix_px : (*m, 3, 4)
        One projection matrix, or several.
    ends_mm : (..., 2, 3)
        Two different points of the line in the world frame; leading axes broadcast with *m.
    points_px : (*m, e, 2)
        Undistorted pixels; e points for each matrix.

    Returns
    -------
    LineDistances
    """
    image = project_with_jacobian(matrix_px, ends_mm)
    uv, xp = image.uv_px, array_namespace(matrix_px, ends_mm, points_px)
    direction = uv[..., 1:, :] - uv[..., :1, :]
    squared = (direction**2).sum(-1)
    normal = (
        xp.stack([-direction[..., 1], direction[..., 0]], axis=-1) / xp.sqrt(squared)[..., None]
    )
    offset = points_px - uv[..., :1, :]
    # The displacement of the line abreast of a point interpolates those of its ends.
    share = (offset * direction).sum(-1) / squared
    across = (normal[..., None] * image.by_point).sum(-2)
    weight = xp.stack([1 - share, share], axis=-1)
    return LineDistances((offset * normal).sum(-1), -weight[..., None] * across[..., None, :, :])
