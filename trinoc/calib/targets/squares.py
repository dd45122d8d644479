"""Boards of squares as their ink: cells of a grid of lines along X and along Y."""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import (
    Charuco,
    Chessboard,
    dark_squares,
    inner_corners_mm,
)
from trinoc.calib.targets.markers import charuco_markers, marker_cells, opencv_dictionary
from trinoc.errors import InputError

# Lines nearer than this, over the board's extent, are one.
_SAME = 1e-7


class SquareSheet(AbstractTarget):
    """A board whose ink is made of rectangles along X and Y: what the fit of grey levels takes.

    Fields
    ------
    name, centres_mm, radius_mm : see `AbstractTarget`.
    nodes_mm : (k, 2) the corners of all squares, those on the rim too, or of tags: every edge
        counts to the nearest.
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
    """The ink of a chessboard, a ChArUco board or an AprilGrid.

    quarters : of a turn, counter-clockwise, by which every tag of an AprilGrid is printed elsewhere
        than `trinoc pattern` draws it. Raises InputError for other boards.
    """
    match board:
        case Chessboard():
            parts = [_squares(board.rows + 1, board.columns + 1, board.square_mm)]
            nodes_mm = inner_corners_mm(board.rows + 2, board.columns + 2, board.square_mm)
        case Charuco():
            parts = _charuco(board)
            nodes_mm = inner_corners_mm(board.rows + 1, board.columns + 1, board.square_mm)
        case AprilGrid():
            parts = _april_grid(board, quarters)
            nodes_mm = board.centres_mm
        case _:
            raise InputError(f"A {type(board).__name__} is no board of squares.")
    bounds = np.concatenate([part.bounds_mm for part in parts])
    same = _SAME * float(np.ptp(bounds))
    x_mm, y_mm = (_distinct(bounds[:, axis], same) for axis in (0, 1))
    ink = np.zeros((len(y_mm) + 1, len(x_mm) + 1), dtype=bool)
    left, right = (_numbers(x_mm, bounds[:, 0, k], same) for k in (0, 1))
    low, high = (_numbers(y_mm, bounds[:, 1, k], same) for k in (0, 1))
    for box in zip(low, high, left, right, strict=True):
        ink[box[0] : box[1], box[2] : box[3]] = True
    return SquareSheet(board.name, board.centres_mm, board.radius_mm, nodes_mm, x_mm, y_mm, ink)


class _Rectangles(NamedTuple):
    """(n, 2, 2) from and to along X, then along Y."""

    bounds_mm: Float[np.ndarray, "n 2 2"]


def _charuco(board: Charuco) -> list[_Rectangles]:
    numbers, middles = charuco_markers(board)
    dictionary = opencv_dictionary(board.dictionary)
    dark = np.ones((board.rows, board.columns), dtype=bool)
    column, up = (
        np.floor(middles / board.square_mm + 0.5 * np.array([board.columns, board.rows]))
        .astype(int)
        .T
    )
    dark[board.rows - 1 - up, column] = False
    markers = [
        _cells(marker_cells(dictionary, int(number), border=1), board.marker_mm, middle)
        for number, middle in zip(numbers, middles, strict=True)
    ]
    size_mm = board.square_mm * np.array([board.columns, board.rows])
    return [_cells(dark, size_mm, np.zeros(2)), *markers]


def _april_grid(board: AprilGrid, quarters: int) -> list[_Rectangles]:
    dictionary = opencv_dictionary(board.dictionary)
    tags = []
    for number, middle in enumerate(board.tags_mm, board.first):
        cells = np.rot90(marker_cells(dictionary, number, border=board.border), quarters)
        tags.append(_cells(cells, board.tag_mm, middle))
    gap_mm, pitch_mm = board.tag_mm * board.spacing, board.tag_mm * (1 + board.spacing)
    # Squares where gaps cross, around the outer tags too.
    row, column = np.divmod(np.arange((board.rows + 1) * (board.columns + 1)), board.columns + 1)
    crossings = pitch_mm * np.stack([column - 0.5 * board.columns, row - 0.5 * board.rows], axis=1)
    one = np.ones((1, 1), dtype=bool)
    return [*tags, *(_cells(one, gap_mm, middle) for middle in crossings)]


def _squares(rows: int, columns: int, side_mm: float) -> _Rectangles:
    return _cells(dark_squares(rows, columns), side_mm * np.array([columns, rows]), np.zeros(2))


def _cells(
    dark: Bool[np.ndarray, "rows columns"],
    size_mm: float | Float[np.ndarray, "2"],
    middle_mm: Float[np.ndarray, "2"],
) -> _Rectangles:
    """The dark ones of cells that fill a box, the top row first."""
    rows, columns = dark.shape
    row, column = np.nonzero(dark)
    low = np.stack([column, rows - 1 - row], axis=1)
    counts = np.array([columns, rows])
    cell = np.broadcast_to(size_mm, (2,)) / counts
    bounds = np.stack([low, low + 1], axis=2) - 0.5 * counts[:, None]
    return _Rectangles(bounds * cell[:, None] + middle_mm[:, None])


def _distinct(values: Float[np.ndarray, "n 2"], same: float) -> Float[np.ndarray, "m"]:
    rising = np.sort(values.ravel())
    return rising[np.concatenate([[True], np.diff(rising) > same])]


def _numbers(
    lines: Float[np.ndarray, "m"], values: Float[np.ndarray, "n"], same: float
) -> Int[np.ndarray, "n"]:
    """The cell that begins at each value's line: one more than the lines before it."""
    return np.searchsorted(lines, values + 2 * same)
