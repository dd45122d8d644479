"""Which pixels of the crossed lines' band see an edge of a line, and beside which circle."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.calib.photometric.gauss_newton import sheet_from_normalised
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
    normalised, by_pixel = rays_of_pixels(lens, np.stack([column, row], axis=1).astype(np.float64))
    x, y = np.asarray(normalised).T
    matrix = np.asarray(_homography(pose))
    scale = 1 / (matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2])
    point = (matrix[:2, :2] @ np.stack([x, y]) + matrix[:2, 2:]) * scale
    slope = (matrix[:2, :2, None] - point[:, None] * matrix[2, :2, None]) * scale
    (xu, xv), (yu, yv) = np.moveaxis(np.asarray(by_pixel), 0, -1)
    along_u, along_v = slope[:, 0] * xu + slope[:, 1] * yu, slope[:, 0] * xv + slope[:, 1] * yv
    squares = (along_u**2).sum(axis=0) + (along_v**2).sum(axis=0)
    area = along_u[0] * along_v[1] - along_u[1] * along_v[0]
    flat = np.sqrt(np.maximum(squares**2 - 4 * area**2, 0.0))
    return point.T, np.sqrt(0.5 * (squares + flat))


_homography = jax.jit(sheet_from_normalised)
