"""Selection of the pixels that determine the pose: those near an edge of ink."""

from typing import NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.equations import CHUNK, Group
from trinoc.calib.photometric.grey_level import Pixels
from trinoc.calib.photometric.ink import Circle, Squares
from trinoc.calib.photometric.sheet_geometry import (
    circle_points_mm,
    lens_rays,
    line_outlines_mm,
    project_to_image,
    sheet_points_of_pixels,
)
from trinoc.calib.photometric.square_pixels import square_pixels
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import SquareSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose

# numerical: fractional bits of OpenCV's drawing coordinates.
_SHIFT = 4
SMALLEST_CAPACITY = 16384  # numerical: smallest padded length of a group
# numerical: number of subsets of the selected pixels; each subset covers the whole sheet evenly.
SUBSETS = 4


class SelectedPixels(NamedTuple):
    """Pixels near an edge of ink, without padding.

    Attributes
    ----------
    column, row : (n,) pixel coordinates.
    circle : (n,) index of the nearest circle, -1 if no circle is near; for a board of squares,
        index of the nearest node of its grid.
    squares : inked cells around each pixel of a board of squares; None for other sheets.
    """

    column: Int[np.ndarray, "n"]
    row: Int[np.ndarray, "n"]
    circle: Int[np.ndarray, "n"]
    squares: Squares | None = None

    @property
    def image_index(self) -> tuple[np.ndarray, np.ndarray]:
        """Index (rows, columns) that selects the pixels from an image array."""
        return self.row, self.column

    def subset(self, index: np.ndarray) -> "SelectedPixels":
        """Pixels at the given indices."""
        return jax.tree.map(lambda field: field[index], self)


class PixelSelection(NamedTuple):
    """Pixels near the edges of a sheet in one image; result of `select_pixels`.

    Attributes
    ----------
    near_circles : pixels near circles only.
    near_lines : pixels near a crossed line.
    corner : (row, column) of the first pixel of the sheet's bounding box.
    flat : (h, w) mask of the pixels in this box that are not near an edge.
    """

    near_circles: SelectedPixels
    near_lines: SelectedPixels
    corner: tuple[int, int]
    flat: Bool[np.ndarray, "h w"]


def select_pixels(
    pose: Pose,
    lens: AbstractLens,
    pattern: Pattern | SquareSheet,
    image_size_px: tuple[int, int],
    reach_px: float,
) -> PixelSelection:
    """Select the pixels near an edge of the sheet's ink.

    Pixels near two circles are excluded, because the model of a pixel has one circle only.

    Parameters
    ----------
    pose, lens : camera, which predicts the edges.
    pattern : the sheet, or the raster of a board of squares.
    image_size_px : (width, height) of the image.
    reach_px : largest distance of a pixel from an edge.
    """
    if isinstance(pattern, SquareSheet):
        pixels = square_pixels(pose, lens, pattern, image_size_px, reach_px)
        selected = SelectedPixels(pixels.column, pixels.row, pixels.node, pixels.squares)
        selected = _interleave(selected)
        none = selected.subset(np.zeros(0, dtype=int))
        return PixelSelection(selected, none, pixels.corner, pixels.flat)
    # OpenCV draws lines of even thickness one pixel wider: by half a pixel on each side.
    thickness = 2 * max(1, round(reach_px - 0.5))
    outlines, of_circle, cross = _outlines(pose, lens, pattern)
    # Only the bounding box of the sheet is processed, to save time in large images.
    corner, shape = _bounding_box(outlines, thickness, image_size_px)
    even, odd = np.zeros((2, *shape), dtype=np.int16)
    canvases, parity = (even, odd), pattern.lattice.sum(axis=1) % 2
    for k, outline in zip(of_circle, _to_fixed_point(outlines - corner), strict=True):
        _draw(canvases[parity[k]], outline, int(k) + 1, thickness)
    lines = np.zeros(shape, dtype=np.uint8)
    for outline in cross:
        outline = _to_fixed_point(outline - corner)
        cv2.fillPoly(lines, [outline], 1, shift=_SHIFT)
        _draw(lines, outline, 1, thickness)
    label = np.maximum(even, odd)
    blank = np.maximum(label, lines) == 0
    row, column = np.nonzero(~blank)
    has_one_circle = (even[row, column] == 0) | (odd[row, column] == 0)
    row, column = row[has_one_circle], column[has_one_circle]
    circle, in_band = label[row, column].astype(np.int64) - 1, lines[row, column] > 0
    row, column = row + corner[1], column + corner[0]
    band = _classify_band(column[in_band], row[in_band], pose, lens, pattern, reach_px)
    near_line = in_band.copy()
    near_line[in_band] = band.is_near_line
    rest = (circle >= 0) & ~near_line
    circle_near_line = band.circle[band.is_near_line]
    return PixelSelection(
        _interleave(SelectedPixels(column[rest], row[rest], circle[rest])),
        _interleave(SelectedPixels(column[near_line], row[near_line], circle_near_line)),
        (int(corner[1]), int(corner[0])),
        blank,
    )


class _BandPixels(NamedTuple):
    """Classification of the pixels in the band around the crossed lines.

    Attributes
    ----------
    is_near_line : (n,) True if an edge of a line is near the pixel. A pixel deep inside a circle,
        or in the gap around a circle, is not near such an edge.
    circle : (n,) index of the circle whose edge or gap is near the pixel; -1 if there is none.
    """

    is_near_line: Bool[np.ndarray, "n"]
    circle: Int[np.ndarray, "n"]


def _classify_band(
    column: Int[np.ndarray, "n"],
    row: Int[np.ndarray, "n"],
    pose: Pose,
    lens: AbstractLens,
    pattern: Pattern,
    reach_px: float,
) -> _BandPixels:
    """Classify the pixels in the band around the crossed lines."""
    is_near_line, circle = np.ones(len(row), dtype=bool), np.full(len(row), -1)
    if not len(row):
        return _BandPixels(is_near_line, circle)
    point_mm, stretch = sheet_points_of_pixels(column, row, pose, lens)
    reach_mm = reach_px * stretch
    gap_radius_mm = pattern.radius_mm + pattern.line_gap_mm
    from_axis_mm = np.abs(pattern.centres_mm).min(axis=1)
    crossed = np.flatnonzero(
        from_axis_mm < gap_radius_mm + pattern.line_width_mm + 2 * float(reach_mm.max())
    )
    if not len(crossed):
        return _BandPixels(is_near_line, circle)
    centres_mm = pattern.centres_mm[crossed]
    squared = (point_mm[:, :1] - centres_mm[:, 0]) ** 2
    squared += (point_mm[:, 1:] - centres_mm[:, 1]) ** 2
    nearest = crossed[squared.argmin(axis=1)]
    from_centre_mm = np.sqrt(squared.min(axis=1))
    radius_mm, hole_mm = pattern.radius_mm[nearest], pattern.inner_radius_mm[nearest]
    within = from_centre_mm < radius_mm + pattern.line_gap_mm + reach_mm
    if pattern.line_style == "stop":
        is_near_line = from_centre_mm > radius_mm + pattern.line_gap_mm - reach_mm
    elif pattern.line_style == "through":
        is_near_line = from_centre_mm > radius_mm - reach_mm
        is_near_line |= (hole_mm > 0) & (from_centre_mm < hole_mm + reach_mm)
    return _BandPixels(is_near_line, np.where(within, nearest, -1))


def _interleave(pixels: SelectedPixels) -> SelectedPixels:
    """Reorder pixels so that the first 1/`SUBSETS` of them covers the whole sheet evenly."""
    order = np.concatenate([np.arange(k, len(pixels.row), SUBSETS) for k in range(SUBSETS)])
    return pixels.subset(order)


def _outlines(
    pose: Pose, lens: AbstractLens, pattern: Pattern
) -> tuple[Float[np.ndarray, "m k 2"], Int[np.ndarray, "m"], Float[np.ndarray, "lines j 2"]]:
    """Outlines of the ink in the image, px.

    Returns
    -------
    (m, k, 2) points on the edges of circles, (m,) index of the circle of each edge, and (lines, j,
    2) points on the outlines of the crossed lines.
    """
    of_circle = np.concatenate([np.arange(len(pattern)), np.flatnonzero(pattern.is_ring)])
    radius = np.concatenate([pattern.radius_mm, pattern.inner_radius_mm[pattern.is_ring]])
    circles = circle_points_mm(pattern.centres_mm[of_circle], radius)
    lines = line_outlines_mm(pattern)
    points = np.concatenate([circles.reshape(-1, 2), lines.reshape(-1, 2)])
    points = np.asarray(project_to_image(pose, lens, points))
    split = circles.shape[0] * circles.shape[1]
    cross = points[split:].reshape(lines.shape)[: 2 if pattern.line_width_mm > 0 else 0]
    return points[:split].reshape(circles.shape), of_circle, cross


def _bounding_box(
    outlines: Float[np.ndarray, "m k 2"], margin_px: int, image_size_px: tuple[int, int]
) -> tuple[Int[np.ndarray, "2"], tuple[int, int]]:
    """Region of the image around the outlines: first pixel (column, row) and shape (rows, columns).

    The margin around the outlines is `margin_px` plus 10 % of their extent.
    """
    points = outlines.reshape(-1, 2)
    size = np.ptp(points, axis=0)
    limit = np.array(image_size_px)
    low = np.clip(np.floor(points.min(axis=0) - 0.1 * size) - margin_px, 0, limit - 1)
    high = np.clip(np.ceil(points.max(axis=0) + 0.1 * size) + margin_px, 0, limit - 1)
    columns, rows = (high - low + 1).astype(int)
    return low.astype(int), (int(rows), int(columns))


def _to_fixed_point(points: Float[np.ndarray, "*m k 2"]) -> Int[np.ndarray, "*m k 2"]:
    return np.round(points * (1 << _SHIFT)).astype(np.int32)


def _draw(canvas: np.ndarray, outline: Int[np.ndarray, "k 2"], value: int, thickness: int) -> None:
    cv2.polylines(canvas, [outline], True, value, thickness, cv2.LINE_8, _SHIFT)


def padded_capacities(near_circles: SelectedPixels, near_lines: SelectedPixels) -> tuple[int, int]:
    """Numbers of pixels to which both groups of pixels are padded.

    Only a few pairs of numbers are possible, because each pair requires a compilation.
    """
    many, few = len(near_circles.row), len(near_lines.row)
    capacity = SMALLEST_CAPACITY
    while capacity < max(many, few):
        capacity *= 4
    return capacity, capacity // 4 if few <= capacity // 4 else capacity


def pad_group(
    pixels: SelectedPixels,
    image: np.ndarray,
    lens: AbstractLens,
    pattern: Pattern | SquareSheet,
    capacity: int,
    dtype: type,
    shift_px: Float[np.ndarray, "n 2"] | None = None,
) -> Group:
    """Pack selected pixels into padded arrays.

    The padding repeats the first pixel with weight 0.

    Parameters
    ----------
    pixels : the pixels.
    image : grey levels.
    lens : the lens.
    pattern : the sheet, or the raster of a board of squares.
    capacity : padded number of pixels.
    dtype : precision of the arrays.
    shift_px : (n, 2) known displacement of the sheet's image at each pixel; None for no
        displacement.
    """
    count = len(pixels.row)
    if not count:
        pixels, shift_px = _padding_pixel(pattern), None
    column, row, circle, squares = pixels
    height, width = image.shape
    uv_px = np.stack([column, row], axis=1).astype(np.float64)
    fields = Pixels(
        ray=lens_rays(lens, uv_px if shift_px is None else uv_px - shift_px),
        position=(uv_px - 0.5 * np.array([width - 1, height - 1])) / (0.5 * width),
        grey=image[row, column],
        weight=np.ones(len(row)),
        sigma=np.ones(len(row)),
        unit=np.ones(len(row)),
        local_ink=_circles(pattern, circle) if squares is None else squares,
    )

    def pad(leaf: np.ndarray) -> np.ndarray:
        array = np.empty((capacity, *leaf.shape[1:]), dtype=dtype)
        array[: len(leaf)], array[len(leaf) :] = leaf, leaf[0]
        return array

    padded = jax.tree.map(pad, fields)
    padded.weight[count:] = 0.0
    return Group(padded, np.asarray(-(-count // CHUNK), dtype=np.int32))


def _circles(pattern: Pattern | SquareSheet, circle: Int[np.ndarray, "n"]) -> Circle:
    """Circle of each pixel by its index in the pattern; the index -1 gives an absent circle."""
    assert isinstance(pattern, Pattern)
    nearest = np.maximum(circle, 0)
    return Circle(
        pattern.centres_mm[nearest],
        pattern.radius_mm[nearest],
        pattern.inner_radius_mm[nearest],
        circle >= 0,
    )


def _padding_pixel(pattern: Pattern | SquareSheet) -> SelectedPixels:
    """Selection of one pixel that is not near an edge, used to pad an empty group."""
    squares = None
    if isinstance(pattern, SquareSheet):
        squares = Squares(np.zeros((1, 2)), np.zeros((1, 2)), np.zeros((1, 9)))
    zero = np.zeros(1, dtype=int)
    return SelectedPixels(zero, zero, zero - 1, squares)
