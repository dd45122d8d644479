"""The cells of ArUco's and AprilTag's markers, by OpenCV's dictionaries."""

import cv2
import numpy as np
from jaxtyping import Bool

from trinoc.calib.targets.checkers import Charuco

# Pixels of OpenCV's drawing for one cell: read off in their middles.
_CELL_PX = 4


def opencv_dictionary(name: str) -> cv2.aruco.Dictionary:
    """One of `DICTIONARIES`."""
    own, count = name.split("_")
    return cv2.aruco.getPredefinedDictionary(
        getattr(cv2.aruco, f"DICT_{own.replace('x', 'X')}_{count}")
    )


def opencv_board(board: Charuco) -> cv2.aruco.CharucoBoard:
    """The same board as OpenCV has it."""
    theirs = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square_mm,
        board.marker_mm,
        opencv_dictionary(board.dictionary),
        np.arange(board.first, board.first + board.rows * board.columns // 2),
    )
    theirs.setLegacyPattern(board.legacy)
    return theirs


def marker_cells(
    dictionary: cv2.aruco.Dictionary, number: int, *, border: int
) -> Bool[np.ndarray, "k k"]:
    """Which cells of a marker are ink, its border of so many cells included, the top row first."""
    cells = dictionary.markerSize + 2 * border
    picture = np.asarray(
        cv2.aruco.generateImageMarker(dictionary, number, cells * _CELL_PX, borderBits=border)
    )
    return picture[_CELL_PX // 2 :: _CELL_PX, _CELL_PX // 2 :: _CELL_PX] < 128


def charuco_markers(board: Charuco) -> tuple[np.ndarray, np.ndarray]:
    """(numbers (m,), middles (m, 2) in mm) of a board's markers."""
    theirs = opencv_board(board)
    middles = np.array([np.asarray(each)[:, :2].mean(axis=0) for each in theirs.getObjPoints()])
    size_mm = board.square_mm * np.array([board.columns, board.rows])
    # OpenCV counts from the top left, downward.
    return np.ravel(theirs.getIds()).astype(int), (middles - 0.5 * size_mm) * [1.0, -1.0]
