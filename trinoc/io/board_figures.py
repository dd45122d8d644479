"""What is printed of a board: its dark squares and markers."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib import (
    AbstractTarget,
    AprilGrid,
    Charuco,
    Chessboard,
    charuco_markers,
    dark_squares,
    marker_cells,
    opencv_dictionary,
)
from trinoc.errors import InputError

# Half the height of what covers a seam, in cells.
_STRIP = 0.25


def ink_polygons(target: AbstractTarget) -> list[Float[np.ndarray, "4 2"]]:
    """Rectangles of ink, in mm on the board.

    Cells of a marker that touch along a row are one rectangle.
    """
    match target:
        case Chessboard():
            rows, columns = target.rows + 1, target.columns + 1
            return _rectangles(dark_squares(rows, columns), target.square_mm)
        case Charuco():
            return _charuco(target)
        case AprilGrid():
            return _april_grid(target)
    raise InputError(f"A {type(target).__name__} cannot be drawn: give a board or a Pattern.")


def _charuco(board: Charuco) -> list[Float[np.ndarray, "4 2"]]:
    with_marker = np.zeros((board.rows, board.columns), dtype=bool)
    figures = []
    dictionary = opencv_dictionary(board.dictionary)
    half = 0.5 * np.array([board.columns, board.rows])
    for number, middle in zip(*charuco_markers(board), strict=True):
        column, up = np.floor(middle / board.square_mm + half).astype(int)
        with_marker[board.rows - 1 - up, column] = True
        cells = marker_cells(dictionary, int(number), border=1)
        figures += [each + middle for each in _rectangles(cells, board.marker_mm / len(cells))]
    return _rectangles(~with_marker, board.square_mm) + figures


def _april_grid(board: AprilGrid) -> list[Float[np.ndarray, "4 2"]]:
    dictionary = opencv_dictionary(board.dictionary)
    figures = []
    for number, middle in enumerate(board.tags_mm, board.first):
        cells = marker_cells(dictionary, number, border=board.border)
        figures += [each + middle for each in _rectangles(cells, board.tag_mm / len(cells))]
    # Squares where gaps cross, around the outer tags too.
    gap, pitch = board.tag_mm * board.spacing, board.tag_mm * (1 + board.spacing)
    square = 0.5 * gap * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for row in np.arange(board.rows + 1) - 0.5 * board.rows:
        for column in np.arange(board.columns + 1) - 0.5 * board.columns:
            figures.append(pitch * np.array([column, row]) + square)
    return figures


def _rectangles(
    ink: Bool[np.ndarray, "rows columns"], side_mm: float
) -> list[Float[np.ndarray, "4 2"]]:
    """Runs of cells with ink, about the middle of all, the first row on top.

    Where two rows touch, a strip lies over the seam: printers leave a hair of white there.
    """
    rows, columns = ink.shape
    runs = [(0.5 * rows - row - 1, 0.5 * rows - row, ink[row]) for row in range(rows)]
    runs += [
        (0.5 * rows - row - _STRIP, 0.5 * rows - row + _STRIP, ink[row - 1] & ink[row])
        for row in range(1, rows)
    ]
    figures = []
    for bottom, top, cells in runs:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(int), [0]])))
        for left, right in edges.reshape(-1, 2) - 0.5 * columns:
            box = [[left, bottom], [right, bottom], [right, top], [left, top]]
            figures.append(side_mm * np.array(box))
    return figures
