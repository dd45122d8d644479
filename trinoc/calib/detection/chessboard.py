"""The corners of a chessboard, by OpenCV's sector-based search, labelled by its colours.

Source: A. Duda and U. Frese, "Accurate detection and localization of checkerboard corners for
calibration", BMVC 2018 (`cv2.findChessboardCornersSB`).
"""

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

from trinoc.calib.detection.corners import (
    distances_to_next,
    levels_of_8_bit,
    refine_corners,
)
from trinoc.calib.detection.detection import Detection, build_detection, rightward_share
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.squares import dark_squares
from trinoc.errors import DetectionError

_SEARCHES = (
    cv2.CALIB_CB_ACCURACY,
    cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE,
    cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE,
)


def detect_chessboard(image: Shaped[np.ndarray, "..."], board: Chessboard) -> Detection:
    """All inner corners of a chessboard, which must be seen whole.

    Where turning the board leaves its colours as they are, the labelling in which X points most
    to the right is taken, and the others stand in `Detection.ambiguity`. A mirror image of a
    chessboard is a chessboard: one picture cannot show which it is.

    Raises DetectionError where no such board is seen.
    """
    picture = search_image(image)
    grey = levels_of_8_bit(picture.grey)
    size = (board.columns, board.rows)
    for flags in _SEARCHES:
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if found:
            break
    else:
        raise DetectionError(
            f"No chessboard {board.name!r} of {board.rows} x {board.columns} inner corners was "
            "found in the picture; show all of it, with a light margin, in focus."
        )
    corners_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    orders = [
        order
        for order in _orders_from_front(corners_px, board)
        if _light_over_dark(grey, corners_px[order], board) > 0
    ]
    if not orders:
        raise DetectionError(
            f"The squares of the chessboard {board.name!r} are not dark and light in turn as its "
            "layout has them; check the numbers of its corners."
        )
    labellings = sorted(
        (np.argsort(order) for order in orders),
        key=lambda index: -rightward_share(corners_px, board.centres_mm[index]),
    )
    # The search puts outer rows of slanted boards aside by some tenths of a pixel.
    fitted = refine_corners(picture, grey, corners_px, distances_to_next(corners_px))
    return build_detection(np.stack(labellings), *fitted, picture.size_px)


def _orders_from_front(
    corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> list[Int[np.ndarray, "_n"]]:
    """Orders in which the corners found are those of the board, seen from its front: for each
    corner of the board the one found there."""
    grid = np.arange(len(corners_px)).reshape(board.rows, board.columns)
    places = corners_px.reshape(board.rows, board.columns, 2)
    across = np.mean(places[:, -1] - places[:, 0], axis=0)
    down = np.mean(places[-1] - places[0], axis=0)
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    turned = [np.rot90(grid, quarters) for quarters in range(4)]
    return [each.ravel() for each in turned if each.shape == grid.shape]


def _light_over_dark(
    grey: UInt8[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> float:
    """How much lighter the light inner squares are than the dark ones."""
    places = corners_px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (places[:-1, :-1] + places[1:, :-1] + places[:-1, 1:] + places[1:, 1:])
    column, row = np.rint(middles).astype(int).reshape(-1, 2).T
    level = grey[row, column].astype(float)
    dark = dark_squares(board.rows - 1, board.columns - 1).ravel()
    return float(level[~dark].mean() - level[dark].mean())
