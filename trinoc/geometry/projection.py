"""The projection of all fits and tools: from a point of the world to a pixel.

Source: Hartley and Zisserman, section 6.1.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics import (
    ArrayLike,
    NumpyOrTraced,
    Scalar,
    Vector2,
    Vector3,
    dot3,
    in_bucket,
    is_traced,
    vector3,
)


class Projection(NamedTuple):
    """Undistorted pixels of points, and how they move with the points.

    uv_px : of each. depth : z in the camera's frame, positive before it, in mm for a matrix whose
    third row has unit length. by_point : (px/mm) derivative by the point's coordinates.
    """

    uv_px: Float[NumpyOrTraced, "*n 2"]
    depth: Float[NumpyOrTraced, "*n"]
    by_point: Float[NumpyOrTraced, "*n 2 3"]


def project_point(
    pose: Pose, lens: AbstractLens, point_world_mm: Float[ArrayLike, "3"]
) -> Float[ArrayLike, "2"]:
    """The pixel that images a point through a lens; for use under `jit`, `grad` and `vmap`.

    Meaningless for a point that the lens cannot see, such as one behind a pinhole camera.
    """
    return lens.project_ray(pose.transform(point_world_mm))


def project_by_matrix(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Float[NumpyOrTraced, "*e 2"]:
    """Undistorted pixels of points by a projection matrix; in NumPy where both are NumPy.

    Of several matrices, (*m 3 4), each has its own points, (*m e 3); leading axes are broadcast.
    """
    image = homogeneous_pixel(matrix_px, points_world_mm)
    return image[..., :2] / image[..., 2:]


def project_with_jacobian(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Projection:
    """`project_by_matrix` with depths and derivatives."""
    image = homogeneous_pixel(matrix_px, points_world_mm)
    uv, depth = image[..., :2] / image[..., 2:], image[..., 2]
    rows: Any = matrix_px if points_world_mm.ndim == 1 else matrix_px[..., None, :, :]
    by_point = rows[..., :2, :3] - uv[..., None] * rows[..., 2:, :3]
    by_point = by_point / depth[..., None, None]
    return Projection(uv, depth, by_point)


def homogeneous_pixel(
    matrix_px: Float[ArrayLike, "*m 3 4"], points_world_mm: Float[ArrayLike, "*n 3"]
) -> Any:
    """Undistorted pixels times the depth, and the depth, (*e 3); matrices as there."""
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
    """(undistorted pixel, depth) of points whose coordinates are arrays of their own.

    Kernels over long arrays of points fuse in this form (`numerics.scalar_vectors`).
    """
    u, v, depth = (
        dot3(vector3(matrix_px[..., k, :3]), point) + matrix_px[..., k, 3] for k in range(3)
    )
    return (u / depth, v / depth), depth


def pixel_change(uv_px: Vector2, depth: Scalar, change: Vector3) -> Vector2:
    """How a pixel moves where its homogeneous one, whose third coordinate is `depth`, changes."""
    u, v = uv_px
    return (change[0] - u * change[2]) / depth, (change[1] - v * change[2]) / depth


def project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 2"]:
    """`project_point` of any number of points, which few programs serve."""
    return in_bucket(partial(_project_points, pose, lens), points_world_mm)


def unproject_pixels(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Unit rays, in the camera frame, of any number of pixels, which few programs serve."""
    return in_bucket(partial(_unproject_pixels, lens), uv_px)


@jax.jit
def _project_points(
    pose: Pose, lens: AbstractLens, points_world_mm: Float[ArrayLike, "n 3"]
) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(partial(project_point, pose, lens))(points_world_mm)


@jax.jit
def _unproject_pixels(
    lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(lens.unproject)(uv_px)
