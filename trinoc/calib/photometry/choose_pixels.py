"""The pixels that know something about the pose: those near an edge of ink."""

from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

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
_REACH_PX = 0.5
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
    width, height = image_size_px
    thickness = max(1, round(2 * (_REACH_SIGMAS * sigma_px + _REACH_PX)))
    even, odd = np.zeros((2, height, width), dtype=np.int32)
    canvases = (even, odd)
    parity = pattern.lattice.sum(axis=1) % 2
    for radius, kept in _radii(pattern):
        outlines = circle_points_mm(pattern.centres_mm[kept], radius[kept])
        drawn = _fixed_point(_project(pose, lens, outlines))
        for k, outline in zip(np.flatnonzero(kept), drawn, strict=True):
            _draw(canvases[parity[k]], outline, int(k) + 1, thickness)
    lines = np.zeros((height, width), dtype=np.uint8)
    if pattern.line_width_mm > 0:
        for outline in _fixed_point(_project(pose, lens, line_outlines_mm(pattern))):
            cv2.fillPoly(lines, [outline], 1, shift=_SHIFT)
            _draw(lines, outline, 1, thickness)
    label = np.maximum(even, odd)
    row, column = np.nonzero((label > 0) & ((even == 0) | (odd == 0)) & (lines == 0))
    near_circles = Chosen(column, row, label[row, column] - 1)
    row, column = np.nonzero((lines > 0) & ((even == 0) | (odd == 0)))
    near_lines = Chosen(column, row, np.full(len(row), -1))
    near_lines = _with_nearest_circle(near_lines, pose, lens, pattern, sigma_px)
    box, corner = _bounding_box((label > 0) | (lines > 0))
    return Choice(near_circles, near_lines, corner, (label[box] == 0) & (lines[box] == 0))


def _bounding_box(mask: Bool[np.ndarray, "h w"]) -> tuple[tuple[slice, slice], tuple[int, int]]:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return (slice(0, 0), slice(0, 0)), (0, 0)
    box = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    return box, (int(rows[0]), int(columns[0]))


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


def _fixed_point(points: Float[np.ndarray, "m k 2"]) -> Int[np.ndarray, "m k 2"]:
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
    distance, nearest = KDTree(pattern.centres_mm).query(sheet)
    # Pixels are foreshortened by the tilt: take the coarsest millimetres per pixel.
    mm_per_px = float(pose.distance_mm) / float(np.min(np.diag(lens.matrix_px)[:2]))
    reach = (_REACH_SIGMAS * sigma_px + _REACH_PX) * mm_per_px / max(-pose.rotation[2, 2], 0.2)
    within = distance < pattern.radius_mm[nearest] + pattern.line_gap_mm + reach
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
