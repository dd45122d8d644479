"""The pixels that know something about the pose: those near an edge of ink."""

from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.lens_arrays import LensArrays
from trinoc.calib.pattern import Pattern
from trinoc.calib.photometry.gauss_newton import Group
from trinoc.calib.photometry.ink import Circle
from trinoc.calib.photometry.model import Pixels
from trinoc.calib.photometry.normal_equations import CHUNK
from trinoc.calib.photometry.outlines import (
    circle_points_mm,
    line_outlines_mm,
    project_to_picture,
)
from trinoc.calib.photometry.sheet_point import Ray
from trinoc.calib.sheet_pose import SheetPose
from trinoc.geometry.arrays import ArrayLike

# Pixels within this many sigmas of an edge, and a little more for an error of the start.
_REACH_SIGMAS = 3.0
_REACH_PX = 0.4
# Fixed-point bits of OpenCV's drawing coordinates.
_SHIFT = 4
_SMALLEST_CAPACITY = 16384


class Chosen(NamedTuple):
    """Pixels near edges, before they are padded.

    Fields
    ------
    column, row : (n,) of the pixel.
    circle : (n,) index of the nearest circle, -1 where none is near.
    """

    column: Int[np.ndarray, "n"]
    row: Int[np.ndarray, "n"]
    circle: Int[np.ndarray, "n"]


class Choice(NamedTuple):
    """Pixels near circles only, pixels near a line of the cross, and where no edge is.

    Fields
    ------
    near_circles, near_lines : see `Chosen`.
    corner : (row, column) of the sheet's bounding box.
    flat : (h, w) pixels of that box that lie near no edge.
    """

    near_circles: Chosen
    near_lines: Chosen
    corner: tuple[int, int]
    flat: Bool[np.ndarray, "h w"]


def choose_pixels(
    pose: SheetPose,
    lens: LensArrays,
    pattern: Pattern,
    image_size_px: tuple[int, int],
    sigma_px: float,
) -> Choice:
    """The pixels within reach of the sheet's edges.

    Pixels within reach of two circles are left out: the model knows one.
    """
    # OpenCV draws an even thickness one pixel wider: half a thickness and a half to each side.
    thickness = 2 * max(1, round(_REACH_SIGMAS * sigma_px + _REACH_PX - 0.5))
    circles = [
        (kept, _project(pose, lens, circle_points_mm(pattern.centres_mm[kept], radius[kept])))
        for radius, kept in _radii(pattern)
    ]
    cross = _project(pose, lens, line_outlines_mm(pattern)) if pattern.line_width_mm > 0 else ()
    # Work in the sheet's bounding box: the rest of a large picture costs nothing.
    corner, shape = _bounding_box([points for _, points in circles], thickness, image_size_px)
    even, odd = np.zeros((2, *shape), dtype=np.int32)
    canvases, parity = (even, odd), pattern.lattice.sum(axis=1) % 2
    for kept, outlines in circles:
        drawn = _fixed_point(outlines - corner)
        for k, outline in zip(np.flatnonzero(kept), drawn, strict=True):
            _draw(canvases[parity[k]], outline, int(k) + 1, thickness)
    lines = np.zeros(shape, dtype=np.uint8)
    for outline in cross:
        drawn = _fixed_point(outline - corner)
        cv2.fillPoly(lines, [drawn], 1, shift=_SHIFT)
        _draw(lines, drawn, 1, thickness)
    label, alone = np.maximum(even, odd), (even == 0) | (odd == 0)
    row, column = np.nonzero((label > 0) & alone & (lines == 0))
    near_circles = Chosen(column + corner[0], row + corner[1], label[row, column] - 1)
    row, column = np.nonzero((lines > 0) & alone)
    near_lines = Chosen(column + corner[0], row + corner[1], np.full(len(row), -1))
    near_lines = _with_nearest_circle(near_lines, pose, lens, pattern, sigma_px)
    flat = (label == 0) & (lines == 0)
    return Choice(near_circles, near_lines, (int(corner[1]), int(corner[0])), flat)


def _bounding_box(
    outlines: list[Float[np.ndarray, "_ k 2"]], margin_px: int, image_size_px: tuple[int, int]
) -> tuple[Int[np.ndarray, "2"], tuple[int, int]]:
    """(column, row) of the corner and (rows, columns) of the part of the picture to look at.

    The crossed lines reach beyond the circles by a little: what a wide margin does not hold of
    them says nothing that the rest does not.
    """
    points = np.concatenate([part.reshape(-1, 2) for part in outlines])
    size = np.ptp(points, axis=0)
    limit = np.array(image_size_px)
    low = np.clip(np.floor(points.min(axis=0) - 0.1 * size) - margin_px, 0, limit - 1)
    high = np.clip(np.ceil(points.max(axis=0) + 0.1 * size) + margin_px, 0, limit - 1)
    columns, rows = (high - low + 1).astype(int)
    return low.astype(int), (int(rows), int(columns))


def _radii(pattern: Pattern) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """(radius of every circle, which circles have such an edge): outer edges, then holes."""
    return (
        (pattern.radius_mm, np.ones(len(pattern), dtype=bool)),
        (pattern.inner_radius_mm, pattern.inner_radius_mm > 0),
    )


def _project(
    pose: SheetPose, lens: LensArrays, outlines: Float[np.ndarray, "m k 2"]
) -> Float[np.ndarray, "m k 2"]:
    flat = outlines.reshape(-1, 2)
    return np.asarray(project_to_picture(pose, lens, flat)).reshape(outlines.shape)


def _fixed_point(points: Float[np.ndarray, "*m k 2"]) -> Int[np.ndarray, "*m k 2"]:
    return np.round(points * (1 << _SHIFT)).astype(np.int32)


def _draw(canvas: np.ndarray, outline: Int[np.ndarray, "k 2"], value: int, thickness: int) -> None:
    cv2.polylines(canvas, [outline], True, value, thickness, cv2.LINE_8, _SHIFT)


def _with_nearest_circle(
    chosen: Chosen, pose: SheetPose, lens: LensArrays, pattern: Pattern, sigma_px: float
) -> Chosen:
    """`chosen` with the circle whose edge, or whose gap in the line, is within reach."""
    if not len(chosen.row):
        return chosen
    pixel = np.stack([chosen.column, chosen.row], axis=1).astype(np.float64)
    inverse = np.linalg.inv(np.asarray(lens.matrix_px) @ np.asarray(pose.cam_from_sheet))
    sheet = np.concatenate([pixel, np.ones((len(pixel), 1))], axis=1) @ inverse.T
    sheet = sheet[:, :2] / sheet[:, 2:]
    # Pixels are foreshortened by the tilt: take the coarsest millimetres per pixel.
    mm_per_px = float(pose.distance_mm) / float(np.min(np.diag(lens.matrix_px)[:2]))
    reach = (_REACH_SIGMAS * sigma_px + _REACH_PX) * mm_per_px / max(-pose.rotation[2, 2], 0.2)
    reach_mm = pattern.radius_mm + pattern.line_gap_mm + reach
    beside = np.abs(pattern.centres_mm).min(axis=1) < reach_mm + pattern.line_width_mm + reach
    candidates = np.flatnonzero(beside)
    if not len(candidates):
        return chosen
    apart = sheet[:, None] - pattern.centres_mm[candidates]
    squared = np.einsum("ncd,ncd->nc", apart, apart)
    best = squared.argmin(axis=1)
    nearest = candidates[best]
    within = squared[np.arange(len(best)), best] < reach_mm[nearest] ** 2
    return chosen._replace(circle=np.where(within, nearest, -1))


def capacity_for(count: int) -> int:
    """The padded length for `count` pixels; few lengths, because each compiles anew."""
    capacity = _SMALLEST_CAPACITY
    while capacity < count:
        capacity *= 4
    return capacity


def group_of(
    chosen: Chosen,
    picture: np.ndarray,
    lens: LensArrays,
    pattern: Pattern,
    capacity: int,
    dtype: type,
) -> Group:
    """The pixels as padded arrays; padding repeats the first pixel, without weight."""
    count = len(chosen.row)
    index = np.zeros(capacity, dtype=np.int64)
    index[:count] = np.arange(count)
    if not count:
        chosen = Chosen(*(np.array([value]) for value in (0, 0, -1)))
    column, row, circle = (field[index] for field in chosen)
    height, width = picture.shape
    place = np.stack([column - 0.5 * (width - 1), row - 0.5 * (height - 1)], axis=1)
    weight = np.zeros(capacity)
    weight[:count] = 1.0
    present = circle >= 0
    nearest = np.maximum(circle, 0)
    pixels = Pixels(
        ray=_rays(lens, np.stack([column, row], axis=1).astype(np.float64)),
        place=place / (0.5 * width),
        grey=picture[row, column].astype(np.float64),
        weight=weight,
        unit=np.ones(capacity),
        circle=Circle(
            pattern.centres_mm[nearest],
            pattern.radius_mm[nearest],
            pattern.inner_radius_mm[nearest],
            present.astype(np.float64),
        ),
    )
    pixels = jax.tree.map(lambda leaf: np.asarray(leaf, dtype=dtype), pixels)
    return Group(pixels, np.asarray(-(-count // CHUNK), dtype=np.int32))


def _rays(lens: LensArrays, uv_px: Float[np.ndarray, "n 2"]) -> Ray:
    (fu, skew, cu), (_, fv, cv), _ = np.asarray(lens.matrix_px)
    if lens.distortion is not None:
        return _distorted_rays(lens, uv_px)
    y = (uv_px[:, 1] - cv) / fv
    normalised = np.stack([(uv_px[:, 0] - cu - skew * y) / fu, y], axis=1)
    by_pixel = np.array([[1 / fu, -skew / (fu * fv)], [0.0, 1 / fv]])
    return Ray(normalised, np.broadcast_to(by_pixel, (len(uv_px), 2, 2)))


@jax.jit
def _distorted_rays(lens: LensArrays, uv_px: Float[ArrayLike, "n 2"]) -> Ray:
    def ray(uv: Float[ArrayLike, "2"]) -> Ray:
        return Ray(lens.normalised_from_pixel(uv), jax.jacfwd(lens.normalised_from_pixel)(uv))

    return jax.vmap(ray)(uv_px)
