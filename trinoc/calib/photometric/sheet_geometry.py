"""Geometry between the flat sheet and the image: rays of pixels, points on the sheet, outlines."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_point
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.small_matrices import inverse_3x3

# numerical: number of pixels per call; a constant avoids further compilations.
_PIECE = 8192
_CIRCLE_POINTS, _SIDE_POINTS = 32, 16  # numerical: points of outlines


class Ray(NamedTuple):
    """Ray of a pixel in the camera frame. Arrays for many pixels have one more axis at the end.

    A ray does not depend on the pose.

    Attributes
    ----------
    direction : (3,) direction through the centre of the pixel, of any length.
    by_pixel : (3, 2) derivatives of `direction` with respect to the pixel coordinates (u, v).
    second_by_pixel : (3, 3) second derivatives of `direction` with respect to uu, uv and vv; None
        for a lens without distortion. Because of them, images of straight edges are curved.
    """

    direction: Float[ArrayLike, "3 *n"]
    by_pixel: Float[ArrayLike, "3 2 *n"]
    second_by_pixel: Float[ArrayLike, "3 3 *n"] | None = None

    def move(self, du: Float[ArrayLike, "*n"], dv: Float[ArrayLike, "*n"]) -> "Ray":
        """Ray of the point (du, dv) px from the pixel, by Taylor expansion."""
        du, dv = du[None], dv[None]
        by_u, by_v = self.by_pixel[:, 0], self.by_pixel[:, 1]
        direction = self.direction + by_u * du + by_v * dv
        if self.second_by_pixel is not None:
            uu, uv, vv = (self.second_by_pixel[:, j] for j in range(3))
            direction = direction + 0.5 * (uu * du * du + vv * dv * dv) + uv * du * dv
            by_u, by_v = by_u + uu * du + uv * dv, by_v + uv * du + vv * dv
        return Ray(direction, jnp.stack([by_u, by_v], axis=1), self.second_by_pixel)


class SheetPoint(NamedTuple):
    """Point of the sheet under a pixel, with derivatives.

    Arrays for many pixels have one more axis at the end.

    Attributes
    ----------
    point_mm : (2,) point (X, Y) on the sheet.
    by_pixel : (2, 2) matrix A, derivative of the point with respect to the pixel coordinates (u,
        v), mm per px.
    depth_slope : (2,) vector w, derivative of the logarithm of the homogeneous coordinate with
        respect to (u, v), per px. The second derivatives of the point are -(A_ij w_k + A_ik w_j)
        plus `second_by_pixel`.
    by_matrix : (3,) ray divided by the homogeneous coordinate. If the rows of the sheet-from-camera
        homography change by dM, point_i changes by (dM_i - point_i dM_2) . by_matrix.
    unit : 1, which the compiler cannot simplify. Division by it makes XLA compute a value once and
        not at every use.
    second_by_pixel : (2, 3) second derivatives of the point with respect to uu, uv and vv due to
        lens distortion; None without distortion.
    """

    point_mm: Float[ArrayLike, "2 *n"]
    by_pixel: Float[ArrayLike, "2 2 *n"]
    depth_slope: Float[ArrayLike, "2 *n"]
    by_matrix: Float[ArrayLike, "3 *n"]
    unit: Float[ArrayLike, "*n"]
    second_by_pixel: Float[ArrayLike, "2 3 *n"] | None = None


def sheet_point(
    sheet_from_camera: Float[ArrayLike, "3 3"], ray: Ray, unit: Float[ArrayLike, "*n"]
) -> SheetPoint:
    """Point of the sheet under each ray, with derivatives with respect to the pixel coordinates.

    Parameters
    ----------
    sheet_from_camera : homography from rays in the camera frame to the sheet.
    ray : rays of the pixels.
    unit : ones (see `SheetPoint`).

    Notes
    -----
    The code uses sums along the first axis. The compiler fuses these into one loop over thousands
    of pixels, which it does not do for products of small matrices.
    """
    aligned = sheet_from_camera.reshape(3, 3, *[1] * (ray.direction.ndim - 1))
    columns = [aligned[:, k] for k in range(3)]
    homogeneous = _combine(columns, ray.direction[:, None])
    scale = 1 / homogeneous[2:]
    point_mm = homogeneous[:2] * scale
    # The logarithmic derivative of the homogeneous coordinate needs no offset.
    origin = jnp.concatenate([point_mm, jnp.zeros_like(scale)])
    slopes = [(column * scale - origin * (column[2:] * scale))[:, None] for column in columns]
    by_pixel = _combine(slopes, ray.by_pixel[:, None])
    return SheetPoint(
        point_mm,
        by_pixel[:2],
        by_pixel[2],
        ray.direction * scale,
        unit,
        None
        if ray.second_by_pixel is None
        else _combine([slope[:2] for slope in slopes], ray.second_by_pixel[:, None]),
    )


def _combine(weights: Sequence[ArrayLike], rows: Float[ArrayLike, "3 *n"]) -> ArrayLike:
    return weights[0] * rows[0] + weights[1] * rows[1] + weights[2] * rows[2]


def lens_rays(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], *, with_second: bool = True
) -> Ray:
    """Ray of each pixel, with derivatives. The first axis of each array counts the pixels.

    Parameters
    ----------
    lens : the lens.
    uv_px : (n, 2) pixel coordinates.
    with_second : True to compute second derivatives for a lens with distortion.
    """
    if lens.has_distortion:
        return _through_distortion(lens, uv_px, with_second)
    (fu, fv), (cu, cv) = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    skew = float(lens.skew_px)
    y = (uv_px[:, 1] - cv) / fv
    direction = np.stack([(uv_px[:, 0] - cu - skew * y) / fu, y, np.ones_like(y)], axis=1)
    by_pixel = np.array([[1 / fu, -skew / (fu * fv)], [0.0, 1 / fv], [0.0, 0.0]])
    return Ray(direction, np.broadcast_to(by_pixel, (len(uv_px), 3, 2)))


def _through_distortion(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], with_second: bool
) -> Ray:
    padded = np.concatenate([uv_px, np.zeros((-len(uv_px) % _PIECE, 2))])
    pieces = [
        _distorted_rays(lens, padded[k : k + _PIECE], with_second=with_second)
        for k in range(0, len(padded), _PIECE)
    ]
    return jax.tree.map(
        lambda *parts: np.concatenate([np.asarray(part) for part in parts])[: len(uv_px)], *pieces
    )


@partial(kept_jit, static_argnames=("with_second",))
def _distorted_rays(
    lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"], *, with_second: bool
) -> Ray:
    def ray(uv: Float[ArrayLike, "2"]) -> Ray:
        first = jax.jacfwd(lens.unproject)
        if not with_second:
            return Ray(lens.unproject(uv), first(uv))
        second = jax.jacfwd(first)(uv)
        second_by_pixel = jnp.stack([second[:, 0, 0], second[:, 0, 1], second[:, 1, 1]], axis=1)
        return Ray(lens.unproject(uv), first(uv), second_by_pixel)

    return jax.vmap(ray)(uv_px)


@kept_jit
def project_to_image(
    pose: Pose, lens: AbstractLens, points_mm: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 2"]:
    """Project points (X, Y) of the flat sheet, mm, to pixel coordinates."""
    world_mm = jnp.concatenate([points_mm, jnp.zeros_like(points_mm[:, :1])], axis=1)
    return jax.vmap(project_point, in_axes=(None, None, 0))(pose, lens, world_mm)


def circle_points_mm(
    centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n k 2"]:
    """Equidistant points on circles of the sheet, (n, k, 2): k points per circle."""
    angle = np.arange(_CIRCLE_POINTS) * (2 * np.pi / _CIRCLE_POINTS)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centres_mm[:, None] + radius_mm[:, None, None] * ring


def line_outlines_mm(pattern: Pattern) -> Float[np.ndarray, "2 k 2"]:
    """Points on the closed outlines of the two crossed lines, (2, k, 2).

    The line along X comes first.
    """
    along = np.linspace(-1.0, 1.0, _SIDE_POINTS)
    half = 0.5 * pattern.line_width_mm
    outlines = []
    for axis, reach in enumerate(pattern.line_half_length_mm):
        side = np.stack([reach * along, np.full(_SIDE_POINTS, half)], axis=1)
        outline = np.concatenate([side, -side])
        outlines.append(outline if axis == 0 else outline[:, ::-1])
    return np.stack(outlines)


def sheet_from_camera(pose: Pose) -> Float[ArrayLike, "3 3"]:
    """Homography from rays in the camera frame to points (X, Y, 1) of the sheet, mm.

    Its last row has unit length. This normalisation is defined for every pose of the sheet.
    """
    inverse = inverse_3x3(pose.cam_from_sheet)
    return inverse / jnp.sqrt(inverse[2] @ inverse[2])


homography_of_pose = kept_jit(sheet_from_camera)


def sheet_points_of_pixels(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Points of a flat sheet under pixels, and the scale of the mapping there.

    Parameters
    ----------
    column, row : (n,) pixel coordinates.
    pose, lens : the camera.

    Returns
    -------
    (n, 2) points (X, Y), mm, and (n,) length of a pixel on the sheet in its longest direction, mm
    per px.
    """
    point, (along_u, along_v) = sheet_points_and_slopes(column, row, pose, lens)
    squares = (along_u**2).sum(axis=0) + (along_v**2).sum(axis=0)
    area = along_u[0] * along_v[1] - along_u[1] * along_v[0]
    flat = np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0))
    return point.T, np.sqrt(0.5 * (squares + flat))


def sheet_points_and_slopes(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "2 n"], tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]]:
    """Points of a flat sheet under pixels, and their derivatives.

    Parameters
    ----------
    column, row : (n,) pixel coordinates.
    pose, lens : the camera.

    Returns
    -------
    (2, n) points (X, Y), mm, and their derivatives with respect to u and to v, each (2, n), mm per
    px.
    """
    uv_px = np.stack([column, row], axis=1).astype(np.float64)
    ray = lens_rays(lens, uv_px, with_second=False)
    direction = np.asarray(ray.direction).T
    matrix = np.asarray(homography_of_pose(pose))
    scale = 1 / (matrix[2] @ direction)
    point = (matrix[:2] @ direction) * scale
    along_u, along_v = (
        (matrix[:2] @ by - point * (matrix[2] @ by)) * scale
        for by in np.moveaxis(np.asarray(ray.by_pixel), 0, -1).swapaxes(0, 1)
    )
    return point, (along_u, along_v)
