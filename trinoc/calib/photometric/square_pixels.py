"""Pixels near the edges of a board of squares, and sample points of its ink and paper."""

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.ink import Squares
from trinoc.calib.photometric.sheet_geometry import project_to_image, sheet_points_and_slopes
from trinoc.calib.targets.squares import SquareSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics.joins import point_tree

# numerical: largest number of grid lines within reach of a pixel along each axis, and of those that
# contain an edge there.
_MOST_LINES, _MOST_EDGES = 5, 2
# numerical: smallest depth of sample points inside ink or paper over the largest depth, and
# smallest length of sampled edges over the longest.
_DEEP = 0.8
# numerical: points of the depth map per smallest distance of grid lines, and its longest side.
_FINE, _LONGEST_MAP = 3.0, 2000


class SquarePixels(NamedTuple):
    """Pixels near an edge of a board of squares.

    Attributes
    ----------
    column, row : (n,) pixel coordinates.
    node : (n,) index of the node of the board's grid that is nearest to each pixel.
    squares : inked cells around each pixel.
    corner : (row, column) of the first pixel of the board's bounding box.
    flat : (h, w) mask of the pixels in this box that are inside ink and not near an edge.
    """

    column: Int[np.ndarray, "n"]
    row: Int[np.ndarray, "n"]
    node: Int[np.ndarray, "n"]
    squares: Squares
    corner: tuple[int, int]
    flat: Bool[np.ndarray, "h w"]


def square_pixels(
    pose: Pose,
    lens: AbstractLens,
    sheet: SquareSheet,
    image_size_px: tuple[int, int],
    reach_px: float,
) -> SquarePixels:
    """Select the pixels near an edge of the board's ink.

    A pixel is not selected if more than two grid lines with an edge along one axis are near it. If
    the cells of a marker are small compared with `reach_px`, only pixels near its outline may
    therefore be selected.

    Parameters
    ----------
    pose, lens : camera, which predicts the edges.
    sheet : raster of the board.
    image_size_px : (width, height) of the image.
    reach_px : largest distance of a pixel from an edge.
    """
    low, high = _box(pose, lens, sheet, image_size_px, reach_px)
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    point, slopes = sheet_points_and_slopes(columns.ravel(), rows.ravel(), pose, lens)
    reach_mm = reach_px * np.hypot(*slopes)
    # The ray of a pixel beyond the horizon meets the plane of the board behind the camera.
    ahead = np.isfinite(point).all(axis=0) & np.isfinite(reach_mm).all(axis=0)
    point, reach_mm = np.where(ahead, point, 1e9), np.where(ahead, reach_mm, 0.0)
    from_x, to_x = (np.searchsorted(sheet.x_mm, point[0] + s * reach_mm[0]) for s in (-1, 1))
    from_y, to_y = (np.searchsorted(sheet.y_mm, point[1] + s * reach_mm[1]) for s in (-1, 1))
    count_x, lines_x = _count_edges(sheet.ink, from_x, to_x, from_y, to_y)
    count_y, lines_y = _count_edges(sheet.ink.T, from_y, to_y, from_x, to_x)
    is_edgeless = (count_x == 0) & (count_y == 0)
    is_selected = ahead & ~is_edgeless & (count_x <= _MOST_EDGES) & (count_y <= _MOST_EDGES)
    flat = ahead & is_edgeless & sheet.ink[from_y, from_x]
    index = np.flatnonzero(is_selected)
    cells_x, x_mm = _cells_and_lines(sheet.x_mm, from_x[index], lines_x[index], point[0, index])
    cells_y, y_mm = _cells_and_lines(sheet.y_mm, from_y[index], lines_y[index], point[1, index])
    ink = sheet.ink[cells_y[:, :, None], cells_x[:, None, :]].reshape(-1, 9).astype(float)
    return SquarePixels(
        columns.ravel()[index],
        rows.ravel()[index],
        np.asarray(point_tree(sheet.nodes_mm).query(point[:, index].T)[1]),
        Squares(x_mm, y_mm, ink),
        (int(low[1]), int(low[0])),
        flat.reshape(rows.shape),
    )


def _box(
    pose: Pose,
    lens: AbstractLens,
    sheet: SquareSheet,
    image_size_px: tuple[int, int],
    reach_px: float,
) -> tuple[Int[np.ndarray, "2"], Int[np.ndarray, "2"]]:
    """First and last pixel (column, row) of the board's bounding box in the image.

    It has a margin of 2 `reach_px`.
    """
    crossings = np.stack(np.meshgrid(sheet.x_mm, sheet.y_mm), axis=-1)
    rim = np.concatenate([crossings[[0, -1]].reshape(-1, 2), crossings[:, [0, -1]].reshape(-1, 2)])
    outline = np.asarray(project_to_image(pose, lens, rim))
    outline = outline[np.isfinite(outline).all(axis=1)]
    limit = np.array(image_size_px) - 1
    low = np.clip(np.floor(outline.min(axis=0) - 2 * reach_px), 0, limit).astype(int)
    high = np.clip(np.ceil(outline.max(axis=0) + 2 * reach_px), 0, limit).astype(int)
    return low, high


def _count_edges(
    ink: Bool[np.ndarray, "_r _c"],
    start: Int[np.ndarray, "n"],
    end: Int[np.ndarray, "n"],
    first_row: Int[np.ndarray, "n"],
    last_row: Int[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "n 2"]]:
    """Count the grid lines near each pixel that contain an edge of ink.

    Parameters
    ----------
    ink : (r, c) mask of the inked cells.
    start, end : (n,) range of the grid lines near each pixel, `end` excluded.
    first_row, last_row : (n,) range of the rows of cells near each pixel, `last_row` included.

    Returns
    -------
    (n,) number of lines with an edge, larger than `_MOST_EDGES` if too many lines are near the
    pixel; (n, 2) indices of the first two such lines, -1 if there are fewer.
    """
    changes = np.concatenate([np.zeros((1, ink.shape[1] - 1)), ink[:, 1:] != ink[:, :-1]])
    above = np.cumsum(changes, axis=0).astype(int)
    count, lines = np.zeros(len(start), dtype=int), np.full((len(start), _MOST_EDGES), -1)
    for step in range(_MOST_LINES):
        line = np.minimum(start + step, ink.shape[1] - 2)
        has_edge = above[last_row + 1, line] > above[first_row, line]
        has_edge &= start + step < end
        for k in range(_MOST_EDGES):
            lines[has_edge & (count == k), k] = line[has_edge & (count == k)]
        count += has_edge
    return np.where(end - start > _MOST_LINES, _MOST_EDGES + 1, count), lines


def _cells_and_lines(
    lines_mm: Float[np.ndarray, "k"],
    first: Int[np.ndarray, "n"],
    lines: Int[np.ndarray, "n 2"],
    pixel_mm: Float[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """Cells around each pixel along one axis, and the positions of the lines between them.

    The three cells lie before, between and after two lines. A missing line (-1) is assumed at the
    pixel, between two equal cells.

    Parameters
    ----------
    lines_mm : (k,) positions of all grid lines.
    first : (n,) index of the cell before the first line.
    lines : (n, 2) indices of the two lines, -1 for a missing line.
    pixel_mm : (n,) positions of the pixels on the board.

    Returns
    -------
    (n, 3) indices of the cells, and (n, 2) positions of the lines, mm.
    """
    cells = np.stack([first, first, first], axis=1)
    positions_mm = np.stack([pixel_mm, pixel_mm], axis=1)
    for k in range(_MOST_EDGES):
        exists = lines[:, k] >= 0
        cells[exists, k + 1 :] = lines[exists, k, None] + 1
        positions_mm[exists, k] = lines_mm[lines[exists, k]]
    return cells, positions_mm


def list_control_points(
    sheet: SquareSheet,
) -> tuple[Float[np.ndarray, "_i 2"], Float[np.ndarray, "_e 2"], Float[np.ndarray, "_p 2"]]:
    """Sample points of a board, mm: deep inside ink, on long edges, and deep inside paper.

    Parameters
    ----------
    sheet : raster of the board.
    """
    step_mm = min(float(np.diff(lines).min()) for lines in (sheet.x_mm, sheet.y_mm)) / _FINE
    extent_mm = max(float(np.ptp(lines)) for lines in (sheet.x_mm, sheet.y_mm))
    step_mm = max(step_mm, extent_mm / _LONGEST_MAP)
    x, y = (
        np.arange(lines[0] + 0.5 * step_mm, lines[-1], step_mm)
        for lines in (sheet.x_mm, sheet.y_mm)
    )
    cells = np.ix_(np.searchsorted(sheet.y_mm, y), np.searchsorted(sheet.x_mm, x))
    dark = sheet.ink[cells].astype(np.uint8)

    def deep(mask: np.ndarray) -> Float[np.ndarray, "k 2"]:
        depth = cv2.distanceTransform(np.pad(mask, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        row, column = np.nonzero(depth > _DEEP * depth.max())
        return np.stack([x[column], y[row]], axis=1)

    upright = _long_edges(sheet.ink, sheet.x_mm, sheet.y_mm)
    lying = _long_edges(sheet.ink.T, sheet.y_mm, sheet.x_mm)[:, ::-1]
    return deep(dark), np.concatenate([upright, lying]), deep(1 - dark)


def _long_edges(
    ink: Bool[np.ndarray, "_r _c"], x_mm: Float[np.ndarray, "n"], y_mm: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "k 2"]:
    """Centres (X, Y) of the longest straight edges along Y, mm.

    x_mm, y_mm : positions of the grid lines.
    """
    change = ink[1:-1, 1:].astype(int) - ink[1:-1, :-1]
    middles, lengths = [], []
    for column, steps in enumerate(change.T):
        turns = np.flatnonzero(np.diff(np.concatenate([[0], steps, [0]])))
        for first, last in pairwise(turns):
            if steps[first]:
                middles.append((x_mm[column], 0.5 * (y_mm[first] + y_mm[last])))
                lengths.append(y_mm[last] - y_mm[first])
    long = np.array(lengths) > _DEEP * max(lengths)
    return np.array(middles)[long]
