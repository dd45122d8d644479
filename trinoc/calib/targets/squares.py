"""Boards of squares: their ink is cells of grids, and every edge lies along X or Y."""

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

# numerical: lines nearer than this, over the board's extent, are one.
_SAME = 1e-7
# numerical: half the height of what covers a seam between two rows, in cells.
_STRIP = 0.25
# numerical: beyond what one board holds.
MOST_EACH_WAY = 999


class CellGrid(NamedTuple):
    """Square cells of a grid about its middle, of which some are inked.

    Fields
    ------
    is_ink : (rows, columns) the top row first.
    cell_mm : side of a cell.
    middle_mm : (2,).
    is_blank : whether these cells are blank paper instead, in the ink of the grids before.
    """

    is_ink: Bool[np.ndarray, "rows columns"]
    cell_mm: float
    middle_mm: Float[np.ndarray, "2"]
    is_blank: bool = False


class AbstractSquareBoard(AbstractBoard):
    """A board whose places are corners of inked cells.

    Fields
    ------
    rows, columns : of what the board counts.
    nodes_mm : (k, 2) the corners of all squares, those on the rim too, or of tags: every edge
        belongs to the nearest.
    """

    rows: AbstractVar[int]
    columns: AbstractVar[int]
    nodes_mm: AbstractVar[Float[np.ndarray, "k 2"]]

    @abc.abstractmethod
    def cell_grids(self, *, quarters: int = 0) -> Sequence[CellGrid]:
        """The inked cells, in the order of painting.

        quarters : of a turn, counter-clockwise, by which another program prints the tags.
        """

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """Zeros: corners have none."""
        return np.zeros(len(self.centres_mm))

    def drawing(self) -> list[Polygon]:
        """Rectangles of ink or of paper. Cells that touch along a row are one."""
        return [
            Polygon(grid.cell_mm * box + grid.middle_mm, not grid.is_blank)
            for grid in self.cell_grids()
            for box in _runs_of_cells(grid.is_ink)
        ]


class SquareSheet(AbstractTarget):
    """A board whose ink is made of rectangles along X and Y: what the fit of grey levels takes.

    Fields
    ------
    name, centres_mm, radius_mm : see `AbstractTarget`.
    nodes_mm : see `AbstractSquareBoard`.
    x_mm, y_mm : (n,), (m,) rising, the lines on which the edges of the ink lie.
    ink : (m + 1, n + 1) which of the cells between them are inked, the lowest row first; the
        outermost ones, beyond all lines, are paper.
    """

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "p 2"]
    radius_mm: Float[np.ndarray, "p"]
    nodes_mm: Float[np.ndarray, "k 2"]
    x_mm: Float[np.ndarray, "n"]
    y_mm: Float[np.ndarray, "m"]
    ink: Bool[np.ndarray, "_r _c"]


def square_sheet(board: AbstractTarget, *, quarters: int = 0) -> SquareSheet:
    """The ink of a board of squares on one grid of lines.

    quarters : see `AbstractSquareBoard.cell_grids`. Raises InputError for other boards.
    """
    if not isinstance(board, AbstractSquareBoard):
        raise InputError(f"A {type(board).__name__} is no board of squares.")
    grids = board.cell_grids(quarters=quarters)
    bounds = np.concatenate([_cell_bounds_mm(grid) for grid in grids])
    is_ink = np.repeat([not grid.is_blank for grid in grids], [grid.is_ink.sum() for grid in grids])
    same = _SAME * float(np.ptp(bounds))
    x_mm, y_mm = (_distinct(bounds[..., axis], same) for axis in (0, 1))
    ink = np.zeros((len(y_mm) + 1, len(x_mm) + 1), dtype=bool)
    # The cell that begins at a line has the number of the lines up to it.
    columns = np.searchsorted(x_mm, bounds[..., 0] + 2 * same)
    rows = np.searchsorted(y_mm, bounds[..., 1] + 2 * same)
    for (left, right), (low, high), inked in zip(columns, rows, is_ink, strict=True):
        ink[low:high, left:right] = inked
    return SquareSheet(
        board.name, board.centres_mm, board.radius_mm, board.nodes_mm, x_mm, y_mm, ink
    )


def _cell_bounds_mm(grid: CellGrid) -> Float[np.ndarray, "c 2 2"]:
    """Lower left and upper right corner of each inked cell."""
    rows, columns = grid.is_ink.shape
    row, column = np.nonzero(grid.is_ink)
    low = np.stack([column - 0.5 * columns, 0.5 * rows - 1 - row], axis=1)
    return np.stack([low, low + 1], axis=1) * grid.cell_mm + grid.middle_mm


def _distinct(values: Float[np.ndarray, "..."], same: float) -> Float[np.ndarray, "m"]:
    rising = np.sort(values.ravel())
    return rising[np.concatenate([[True], np.diff(rising) > same])]


def _runs_of_cells(is_ink: Bool[np.ndarray, "rows columns"]) -> list[Float[np.ndarray, "4 2"]]:
    """Runs of inked cells along the rows, about the middle of all, in cells.

    Where two rows touch, a strip lies over the seam: printers leave a hair of white there.
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
    """Places row by row, each from the left or from the right, about their middle; not to be
    written to, since a fit asks for them thousands of times."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    upward = 0.5 * (rows - 1) - row if top_first else row - 0.5 * (rows - 1)
    rightward = column - 0.5 * (columns - 1)
    places = pitch_mm * np.stack([-rightward if right_first else rightward, upward], axis=1)
    places.flags.writeable = False
    return places


def dark_squares(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Which squares of a chessboard are dark, the top left one among them."""
    return np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0


def check_size(name: str, rows: int, columns: int, what: str, side_mm: float) -> None:
    """Raises InputError for a board without a size, or of too few or too many `what`."""
    if not 3 <= min(rows, columns) <= max(rows, columns) <= MOST_EACH_WAY:
        size = "small" if min(rows, columns) < 3 else "large"
        raise InputError(
            f"The board {name!r} is too {size}: give 3 to {MOST_EACH_WAY} {what} each way."
        )
    if not (np.isfinite(side_mm) and side_mm > 0.0):
        raise InputError(f"The board {name!r} has squares of {side_mm:g} mm: give their side.")
