"""Boards made of squares: their ink consists of grid cells, and every edge lies along X or Y."""

import abc
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import equinox as eqx
import numpy as np
from equinox import AbstractVar
from jaxtyping import Bool, Float

from trinoc.calib.targets.abstract_target import AbstractBoard, AbstractTarget, Polygon
from trinoc.errors import InputError

# numerical: lines closer than this share of the board's extent are merged.
_SAME = 1e-7
# numerical: half the height of the strip that covers a seam between two rows, in cells.
_STRIP = 0.25
# numerical: larger boards cannot be printed.
MOST_EACH_WAY = 999


class CellGrid(NamedTuple):
    """Grid of square cells, some of which are painted.

    Attributes
    ----------
    is_ink : (rows, columns) mask of the painted cells, top row first.
    cell_mm : side of a cell.
    middle_mm : (2,) centre of the grid in the board's frame.
    is_blank : True if the cells in `is_ink` are painted in paper colour, over the cells of earlier
        grids.
    """

    is_ink: Bool[np.ndarray, "rows columns"]
    cell_mm: float
    middle_mm: Float[np.ndarray, "2"]
    is_blank: bool = False


class AbstractSquareBoard(AbstractBoard):
    """Board whose ink consists of square cells. Its points are corners of inked cells.

    Attributes
    ----------
    rows, columns : numbers of inner corners, squares or tags, depending on the class.
    nodes_mm : (k, 2) corners of all squares or tags in the board's frame, including those on the
        outer edge. The fit to grey levels divides the board into one block around each node.
    """

    rows: AbstractVar[int]
    columns: AbstractVar[int]
    nodes_mm: AbstractVar[Float[np.ndarray, "k 2"]]

    @abc.abstractmethod
    def cell_grids(self, *, quarters: int = 0) -> Sequence[CellGrid]:
        """Inked cells as grids, in painting order.

        Parameters
        ----------
        quarters : number of counter-clockwise quarter turns of each tag about its centre. Some
            programs print rotated tags.
        """

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """Radii of circles around the points: zeros, because the points are corners."""
        return np.zeros(len(self.centres_mm))

    def drawing(self) -> list[Polygon]:
        """Rectangles of ink or paper colour.

        One rectangle covers neighbouring painted cells of a row.
        """
        return [
            Polygon(grid.cell_mm * box + grid.middle_mm, not grid.is_blank)
            for grid in self.cell_grids()
            for box in _runs_of_cells(grid.is_ink)
        ]


class SquareSheet(AbstractTarget):
    """Board of squares as a raster of ink on one irregular grid, for the fit to grey levels.

    Attributes
    ----------
    name, centres_mm, radius_mm : see `AbstractTarget`.
    nodes_mm : see `AbstractSquareBoard`.
    x_mm, y_mm : (n,), (m,) increasing positions of the grid lines. All edges of ink lie on grid
        lines.
    ink : (m + 1, n + 1) mask of the inked cells between the grid lines, lowest row first. The
        outermost cells, beyond all lines, are paper.
    """

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "p 2"]
    radius_mm: Float[np.ndarray, "p"]
    nodes_mm: Float[np.ndarray, "k 2"]
    x_mm: Float[np.ndarray, "n"]
    y_mm: Float[np.ndarray, "m"]
    ink: Bool[np.ndarray, "_r _c"]


def square_sheet(board: AbstractTarget, *, quarters: int = 0) -> SquareSheet:
    """Convert a board of squares to a raster of its ink.

    Parameters
    ----------
    board : a chessboard, ChArUco board or grid of AprilTags.
    quarters : see `AbstractSquareBoard.cell_grids`.

    Raises
    ------
    InputError : the board is not made of squares.
    """
    if not isinstance(board, AbstractSquareBoard):
        raise InputError(
            f"A {type(board).__name__} is no board of squares: give a Chessboard, Charuco or "
            "AprilGrid."
        )
    grids = board.cell_grids(quarters=quarters)
    bounds = np.concatenate([_cell_bounds_mm(grid) for grid in grids])
    is_ink = np.repeat([not grid.is_blank for grid in grids], [grid.is_ink.sum() for grid in grids])
    tolerance_mm = _SAME * float(np.ptp(bounds))
    x_mm, y_mm = (_distinct(bounds[..., axis], tolerance_mm) for axis in (0, 1))
    ink = np.zeros((len(y_mm) + 1, len(x_mm) + 1), dtype=bool)
    # The cell that begins at a line has the number of the lines up to it.
    columns = np.searchsorted(x_mm, bounds[..., 0] + 2 * tolerance_mm)
    rows = np.searchsorted(y_mm, bounds[..., 1] + 2 * tolerance_mm)
    for (left, right), (low, high), inked in zip(columns, rows, is_ink, strict=True):
        ink[low:high, left:right] = inked
    return SquareSheet(
        board.name, board.centres_mm, board.radius_mm, board.nodes_mm, x_mm, y_mm, ink
    )


def _cell_bounds_mm(grid: CellGrid) -> Float[np.ndarray, "c 2 2"]:
    """Lower left and upper right corner of each painted cell, mm; axes (cell, corner, x or y)."""
    rows, columns = grid.is_ink.shape
    row, column = np.nonzero(grid.is_ink)
    low = np.stack([column - 0.5 * columns, 0.5 * rows - 1 - row], axis=1)
    return np.stack([low, low + 1], axis=1) * grid.cell_mm + grid.middle_mm


def _distinct(values: Float[np.ndarray, "..."], tolerance_mm: float) -> Float[np.ndarray, "m"]:
    rising = np.sort(values.ravel())
    return rising[np.concatenate([[True], np.diff(rising) > tolerance_mm])]


def _runs_of_cells(is_ink: Bool[np.ndarray, "rows columns"]) -> list[Float[np.ndarray, "4 2"]]:
    """Corners of rectangles that cover the painted cells.

    Coordinates are in cells, relative to the centre of the grid. One rectangle covers neighbouring
    cells of a row. Further strips cover the seams between painted rows, because printers leave a
    thin white line there.
    """
    rows, columns = is_ink.shape
    runs = [(0.5 * rows - row - 1, 0.5 * rows - row, is_ink[row]) for row in range(rows)]
    runs += [
        (0.5 * rows - row - _STRIP, 0.5 * rows - row + _STRIP, is_ink[row - 1] & is_ink[row])
        for row in range(1, rows)
    ]
    boxes = []
    for bottom, top, cells in runs:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(int), [0]])))
        for left, right in edges.reshape(-1, 2) - 0.5 * columns:
            boxes.append(np.array([[left, bottom], [right, bottom], [right, top], [left, top]]))
    return boxes


@lru_cache
def grid_mm(
    rows: int, columns: int, pitch_mm: float, *, top_first: bool, right_first: bool = False
) -> Float[np.ndarray, "n 2"]:
    """Points of a regular grid centred on the origin, row by row, (n, 2), mm.

    Parameters
    ----------
    rows, columns : numbers of points.
    pitch_mm : distance between neighbouring points.
    top_first : True if the first row is the top row.
    right_first : True if each row starts at the right.

    Notes
    -----
    The array is cached and read-only, because a fit requests it thousands of times.
    """
    row, column = np.divmod(np.arange(rows * columns), columns)
    upward = 0.5 * (rows - 1) - row if top_first else row - 0.5 * (rows - 1)
    rightward = column - 0.5 * (columns - 1)
    points_mm = pitch_mm * np.stack([-rightward if right_first else rightward, upward], axis=1)
    points_mm.flags.writeable = False
    return points_mm


def dark_squares(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Mask of the dark squares of a chessboard. The top left square is dark.

    Parameters
    ----------
    rows, columns : numbers of squares.
    """
    return np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0


def check_size(name: str, rows: int, columns: int, what: str, side_mm: float) -> None:
    """Raise `InputError` if the number of rows or columns, or the side of a square, is impossible.

    Parameters
    ----------
    name : name of the board, for the message.
    rows, columns : the numbers.
    what : name in the plural of the objects that `rows` and `columns` count.
    side_mm : side of a square.
    """
    if not 3 <= min(rows, columns) <= max(rows, columns) <= MOST_EACH_WAY:
        size = "small" if min(rows, columns) < 3 else "large"
        raise InputError(
            f"The board {name!r} is too {size}: give 3 to {MOST_EACH_WAY} {what} each way."
        )
    if not (np.isfinite(side_mm) and side_mm > 0.0):
        raise InputError(f"The board {name!r} has squares of {side_mm:g} mm: give a positive side.")
