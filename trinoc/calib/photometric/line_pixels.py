"""Which pixels of the crossed lines' band see an edge of a line, and beside which circle."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.calib.photometric.gauss_newton import sheet_from_camera
from trinoc.calib.photometric.rays import rays_of_pixels
from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Pose


class LineView(NamedTuple):
    """What pixels of the lines' band are near to.

    Fields
    ------
    sees_line : (n,) whether an edge of a line is within reach; deep inside a circle or its gap
        there is none.
    circle : (n,) index of the circle whose edge, or whose gap in the line, is within reach;
        -1 where there is none.
    """

    sees_line: Bool[np.ndarray, "n"]
    circle: Int[np.ndarray, "n"]


def line_view(
    column: Int[np.ndarray, "n"],
    row: Int[np.ndarray, "n"],
    pose: Pose,
    lens: AbstractLens,
    pattern: Pattern,
    reach_px: float,
) -> LineView:
    """Tell the pixels of the lines' band apart by the circles that the lines meet."""
    sees_line, circle = np.ones(len(row), dtype=bool), np.full(len(row), -1)
    if not len(row):
        return LineView(sees_line, circle)
    point_mm, stretch = places_of_pixels(column, row, pose, lens)
    reach_mm = reach_px * stretch
    gap_radius_mm = pattern.radius_mm + pattern.line_gap_mm
    from_axis_mm = np.abs(pattern.centres_mm).min(axis=1)
    met = np.flatnonzero(
        from_axis_mm < gap_radius_mm + pattern.line_width_mm + 2 * float(reach_mm.max())
    )
    if not len(met):
        return LineView(sees_line, circle)
    centres_mm = pattern.centres_mm[met]
    squared = (point_mm[:, :1] - centres_mm[:, 0]) ** 2
    squared += (point_mm[:, 1:] - centres_mm[:, 1]) ** 2
    nearest = met[squared.argmin(axis=1)]
    from_centre_mm = np.sqrt(squared.min(axis=1))
    radius_mm, hole_mm = pattern.radius_mm[nearest], pattern.inner_radius_mm[nearest]
    within = from_centre_mm < radius_mm + pattern.line_gap_mm + reach_mm
    if pattern.line_style == "stop":
        sees_line = from_centre_mm > radius_mm + pattern.line_gap_mm - reach_mm
    elif pattern.line_style == "through":
        sees_line = from_centre_mm > radius_mm - reach_mm
        sees_line |= (hole_mm > 0) & (from_centre_mm < hole_mm + reach_mm)
    return LineView(sees_line, np.where(within, nearest, -1))


def places_of_pixels(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Places of a flat sheet under pixels, in mm, and the largest mm per pixel about each."""
    point, (along_u, along_v) = places_and_slopes(column, row, pose, lens)
    squares = (along_u**2).sum(axis=0) + (along_v**2).sum(axis=0)
    area = along_u[0] * along_v[1] - along_u[1] * along_v[0]
    flat = np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0))
    return point.T, np.sqrt(0.5 * (squares + flat))


def places_and_slopes(
    column: Shaped[np.ndarray, "n"], row: Shaped[np.ndarray, "n"], pose: Pose, lens: AbstractLens
) -> tuple[Float[np.ndarray, "2 n"], tuple[Float[np.ndarray, "2 n"], Float[np.ndarray, "2 n"]]]:
    """Places of a flat sheet under pixels, in mm, and their derivatives by u and by v."""
    uv_px = np.stack([column, row], axis=1).astype(np.float64)
    ray = rays_of_pixels(lens, uv_px, with_bend=False)
    direction = np.asarray(ray.direction).T
    matrix = np.asarray(_homography(pose))
    scale = 1 / (matrix[2] @ direction)
    point = (matrix[:2] @ direction) * scale
    along_u, along_v = (
        (matrix[:2] @ by - point * (matrix[2] @ by)) * scale
        for by in np.moveaxis(np.asarray(ray.by_pixel), 0, -1).swapaxes(0, 1)
    )
    return point, (along_u, along_v)


_homography = jax.jit(sheet_from_camera)
