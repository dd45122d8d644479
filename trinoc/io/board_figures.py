"""What is printed of a chessboard or a ChArUco board: its dark squares and markers."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib import AbstractTarget, Charuco, Chessboard, dark_squares, opencv_board
from trinoc.errors import InputError

# Pixels of OpenCV's drawing for one cell of a marker: read off in their middles.
_CELL_PX = 4


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
    raise InputError(f"A {type(target).__name__} cannot be drawn: give a board or a Pattern.")


def _charuco(board: Charuco) -> list[Float[np.ndarray, "4 2"]]:
    theirs = opencv_board(board)
    middle = np.array([board.columns, board.rows]) * 0.5 * board.square_mm
    corner_of_marker = [np.asarray(corners)[:, :2] for corners in theirs.getObjPoints()]
    with_marker = np.zeros((board.rows, board.columns), dtype=bool)
    figures = []
    dictionary = theirs.getDictionary()
    cells = dictionary.markerSize + 2
    for number, corners in zip(np.ravel(theirs.getIds()), corner_of_marker, strict=True):
        column, row = (corners.mean(axis=0) // board.square_mm).astype(int)
        with_marker[row, column] = True
        picture = cv2.aruco.generateImageMarker(dictionary, int(number), cells * _CELL_PX)
        ink = np.asarray(picture)[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128
        # OpenCV counts from the top left, downward.
        place = corners.mean(axis=0) - middle
        figures += [
            each + place * np.array([1.0, -1.0])
            for each in _rectangles(ink, board.marker_mm / cells)
        ]
    return _rectangles(~with_marker, board.square_mm) + figures


def _rectangles(
    ink: Bool[np.ndarray, "rows columns"], side_mm: float
) -> list[Float[np.ndarray, "4 2"]]:
    """Runs of cells with ink, about the middle of all, the first row on top."""
    rows, columns = ink.shape
    figures = []
    for row in range(rows):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], ink[row].astype(int), [0]])))
        top = 0.5 * rows - row
        for left, right in edges.reshape(-1, 2) - 0.5 * columns:
            box = [[left, top - 1], [right, top - 1], [right, top], [left, top]]
            figures.append(side_mm * np.array(box))
    return figures
