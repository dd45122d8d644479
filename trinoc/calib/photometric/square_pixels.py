"""Pixels near the edges of a board of squares, and a first guess of its light and ink."""

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.photometric.ink import Squares
from trinoc.calib.photometric.sheet_places import places_and_slopes, project_to_image
from trinoc.calib.targets.squares import SquareSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose
from trinoc.numerics.joins import point_tree

# numerical: of a table: lines within reach of a pixel that are looked at along each axis, and that
# may carry edges.
_MOST_LINES, _MOST_EDGES = 5, 2
# numerical: samples of a start: so deep inside, over the largest depth that there is.
_DEEP = 0.8
# numerical: points of the map of depths per least distance between lines, and its longest side.
_FINE, _LONGEST_MAP = 3.0, 2000


class SquarePixels(NamedTuple):
    """Pixels of a board of squares.

    Fields
    ------
    column, row : (n,) of those near an edge.
    node : (n,) the board's node nearest to each.
    squares : (n, ...) the ink about each.
    first : (row, column) of the board's box.
    flat : (h, w) pixels of that box within ink and near no edge.
    """

    column: Int[np.ndarray, "n"]
    row: Int[np.ndarray, "n"]
    node: Int[np.ndarray, "n"]
    squares: Squares
    first: tuple[int, int]
    flat: Bool[np.ndarray, "h w"]


def square_pixels(
    pose: Pose,
    lens: AbstractLens,
    sheet: SquareSheet,
    image_size_px: tuple[int, int],
    reach_px: float,
) -> SquarePixels:
    """The pixels within reach of an edge, and of no more than two lines of edges along each axis.

    Of markers whose cells are smaller than that, the outline is left, or nothing.
    """
    low, high = _box(pose, lens, sheet, image_size_px, reach_px)
    rows, columns = np.mgrid[low[1] : high[1] + 1, low[0] : high[0] + 1]
    point, slopes = places_and_slopes(columns.ravel(), rows.ravel(), pose, lens)
    reach_mm = reach_px * np.hypot(*slopes)
    # A pixel that looks past the board has a place behind the camera.
    ahead = np.isfinite(point).all(axis=0) & np.isfinite(reach_mm).all(axis=0)
    point, reach_mm = np.where(ahead, point, 1e9), np.where(ahead, reach_mm, 0.0)
    from_x, to_x = (np.searchsorted(sheet.x_mm, point[0] + s * reach_mm[0]) for s in (-1, 1))
    from_y, to_y = (np.searchsorted(sheet.y_mm, point[1] + s * reach_mm[1]) for s in (-1, 1))
    count_x, lines_x = _count_edges(sheet.ink, from_x, to_x, from_y, to_y)
    count_y, lines_y = _count_edges(sheet.ink.T, from_y, to_y, from_x, to_x)
    none = (count_x == 0) & (count_y == 0)
    chosen = ahead & ~none & (count_x <= _MOST_EDGES) & (count_y <= _MOST_EDGES)
    flat = ahead & none & sheet.ink[from_y, from_x]
    at = np.flatnonzero(chosen)
    cells_x, x_mm = _cells_and_lines(sheet.x_mm, from_x[at], lines_x[at], point[0, at])
    cells_y, y_mm = _cells_and_lines(sheet.y_mm, from_y[at], lines_y[at], point[1, at])
    ink = sheet.ink[cells_y[:, :, None], cells_x[:, None, :]].reshape(-1, 9).astype(float)
    return SquarePixels(
        columns.ravel()[at],
        rows.ravel()[at],
        np.asarray(point_tree(sheet.nodes_mm).query(point[:, at].T)[1]),
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
    """(column, row) of the first and the last pixel to look at: of lines' crossings and beyond."""
    crossings = np.stack(np.meshgrid(sheet.x_mm, sheet.y_mm), axis=-1)
    around = np.concatenate(
        [crossings[[0, -1]].reshape(-1, 2), crossings[:, [0, -1]].reshape(-1, 2)]
    )
    outline = np.asarray(project_to_image(pose, lens, around))
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
    """How many of the lines from `start` to before `end` carry an edge in some of the rows, and the
    first two of them; -1 for none. More lines than are looked at count as too many."""
    changes = np.concatenate([np.zeros((1, ink.shape[1] - 1)), ink[:, 1:] != ink[:, :-1]])
    above = np.cumsum(changes, axis=0).astype(int)
    count, lines = np.zeros(len(start), dtype=int), np.full((len(start), _MOST_EDGES), -1)
    for step in range(_MOST_LINES):
        line = np.minimum(start + step, ink.shape[1] - 2)
        carries = above[last_row + 1, line] > above[first_row, line]
        carries &= start + step < end
        for k in range(_MOST_EDGES):
            lines[carries & (count == k), k] = line[carries & (count == k)]
        count += carries
    return np.where(end - start > _MOST_LINES, _MOST_EDGES + 1, count), lines


def _cells_and_lines(
    lines_mm: Float[np.ndarray, "k"],
    first: Int[np.ndarray, "n"],
    lines: Int[np.ndarray, "n 2"],
    at_mm: Float[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "n 3"], Float[np.ndarray, "n 2"]]:
    """The cells before, between and after two lines, and where these lie; a line that is none lies
    at the pixel, between cells that are one."""
    cells = np.stack([first, first, first], axis=1)
    places = np.stack([at_mm, at_mm], axis=1)
    for k in range(_MOST_EDGES):
        there = lines[:, k] >= 0
        cells[there, k + 1 :] = lines[there, k, None] + 1
        places[there, k] = lines_mm[lines[there, k]]
    return cells, places


def list_control_places(
    sheet: SquareSheet,
) -> tuple[Float[np.ndarray, "_i 2"], Float[np.ndarray, "_e 2"], Float[np.ndarray, "_p 2"]]:
    """Places deep in ink, on long edges and deep in the paper between."""
    step_mm = min(float(np.diff(lines).min()) for lines in (sheet.x_mm, sheet.y_mm)) / _FINE
    extent_mm = max(float(np.ptp(lines)) for lines in (sheet.x_mm, sheet.y_mm))
    step_mm = max(step_mm, extent_mm / _LONGEST_MAP)
    x, y = (
        np.arange(lines[0] + 0.5 * step_mm, lines[-1], step_mm)
        for lines in (sheet.x_mm, sheet.y_mm)
    )
    cells = np.ix_(np.searchsorted(sheet.y_mm, y), np.searchsorted(sheet.x_mm, x))
    dark = sheet.ink[cells].astype(np.uint8)

    def deep(where: np.ndarray) -> Float[np.ndarray, "k 2"]:
        depth = cv2.distanceTransform(np.pad(where, 1), cv2.DIST_L2, 5)[1:-1, 1:-1]
        row, column = np.nonzero(depth > _DEEP * depth.max())
        return np.stack([x[column], y[row]], axis=1)

    upright = _long_edges(sheet.ink, sheet.x_mm, sheet.y_mm)
    lying = _long_edges(sheet.ink.T, sheet.y_mm, sheet.x_mm)[:, ::-1]
    return deep(dark), np.concatenate([upright, lying]), deep(1 - dark)


def _long_edges(
    ink: Bool[np.ndarray, "_r _c"], x_mm: Float[np.ndarray, "n"], y_mm: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "k 2"]:
    """The middles of the longest straight edges along Y."""
    change = ink[1:-1, 1:].astype(int) - ink[1:-1, :-1]
    middles, lengths = [], []
    for column, own in enumerate(change.T):
        turns = np.flatnonzero(np.diff(np.concatenate([[0], own, [0]])))
        for first, last in pairwise(turns):
            if own[first]:
                middles.append((x_mm[column], 0.5 * (y_mm[first] + y_mm[last])))
                lengths.append(y_mm[last] - y_mm[first])
    long = np.array(lengths) > _DEEP * max(lengths)
    return np.array(middles)[long]
