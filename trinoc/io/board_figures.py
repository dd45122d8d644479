"""What is printed of a board: its dark squares and markers."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib import (
    AbstractTarget,
    AprilGrid,
    Charuco,
    Chessboard,
    dark_squares,
    opencv_board,
    opencv_dictionary,
)
from trinoc.errors import InputError

# Pixels of OpenCV's drawing for one cell of a marker: read off in their middles.
_CELL_PX = 4
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
    theirs = opencv_board(board)
    middle = np.array([board.columns, board.rows]) * 0.5 * board.square_mm
    corner_of_marker = [np.asarray(corners)[:, :2] for corners in theirs.getObjPoints()]
    with_marker = np.zeros((board.rows, board.columns), dtype=bool)
    figures = []
    dictionary = theirs.getDictionary()
    for number, corners in zip(np.ravel(theirs.getIds()), corner_of_marker, strict=True):
        column, row = (corners.mean(axis=0) // board.square_mm).astype(int)
        with_marker[row, column] = True
        # OpenCV counts from the top left, downward.
        place = corners.mean(axis=0) - middle
        figures += [
            each + place * np.array([1.0, -1.0])
            for each in _marker(dictionary, int(number), board.marker_mm, border=1)
        ]
    return _rectangles(~with_marker, board.square_mm) + figures


def _april_grid(board: AprilGrid) -> list[Float[np.ndarray, "4 2"]]:
    dictionary = opencv_dictionary(board.dictionary)
    figures = []
    for number, middle in enumerate(board.tags_mm, board.first):
        tag = _marker(dictionary, number, board.tag_mm, border=board.border)
        figures += [each + middle for each in tag]
    # Squares where gaps cross, around the outer tags too.
    gap, pitch = board.tag_mm * board.spacing, board.tag_mm * (1 + board.spacing)
    square = 0.5 * gap * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for row in np.arange(board.rows + 1) - 0.5 * board.rows:
        for column in np.arange(board.columns + 1) - 0.5 * board.columns:
            figures.append(pitch * np.array([column, row]) + square)
    return figures


def _marker(
    dictionary: cv2.aruco.Dictionary, number: int, side_mm: float, *, border: int
) -> list[Float[np.ndarray, "4 2"]]:
    """The ink of a marker about its middle."""
    cells = dictionary.markerSize + 2 * border
    picture = np.asarray(
        cv2.aruco.generateImageMarker(dictionary, number, cells * _CELL_PX, borderBits=border)
    )
    ink = picture[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128
    return _rectangles(ink, side_mm / cells)


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
