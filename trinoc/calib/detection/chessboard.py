"""The corners of a chessboard, by OpenCV's searches, labelled by its colours.

Sources: V. Vezhnevets' search for quadrangles (`cv2.findChessboardCorners`); A. Duda and U. Frese,
"Accurate detection and localization of checkerboard corners for calibration", BMVC 2018
(`cv2.findChessboardCornersSB`).
"""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped, UInt8

from trinoc.calib.detection.corners import (
    distances_to_next,
    levels_of_8_bit,
    refine_corners,
)
from trinoc.calib.detection.detection import Detection, build_detection, rightward_share
from trinoc.calib.detection.neighbour_check import are_in_place, predict_from_neighbours
from trinoc.calib.detection.search_image import search_image
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.squares import dark_squares
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import DetectionError

_CLASSIC = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
_EXHAUSTIVE = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE


def detect_chessboard(
    image: Shaped[np.ndarray, "..."], board: Chessboard, tuning: CalibTuning
) -> Detection:
    """All inner corners of a chessboard, which must be seen whole.

    Where turning the board leaves its colours as they are, the labelling in which X points most
    to the right is taken, and the others stand in `Detection.ambiguity`. The same holds for a board
    whose first square is light, so that no turn has the colours of the layout. A mirror image of a
    chessboard is a chessboard: one image cannot show which it is.

    Raises DetectionError where no such board is seen.
    """
    picture = search_image(image)
    grey = levels_of_8_bit(picture.grey)
    corners_px = _search(grey, board, tuning)
    if corners_px is None:
        raise DetectionError(
            f"No chessboard {board.name!r} of {board.rows} x {board.columns} inner corners was "
            "found in the picture; show all of it, with a light margin, in focus."
        )
    every = _orders_from_front(corners_px, board)
    orders = [order for order in every if _light_over_dark(grey, corners_px[order], board) > 0]
    labellings = sorted(
        (np.argsort(order) for order in orders or every),
        key=lambda index: -rightward_share(corners_px, board.centres_mm[index]),
    )
    # The search puts outer rows of slanted boards aside by some tenths of a pixel.
    fitted = refine_corners(picture, grey, corners_px, distances_to_next(corners_px), tuning)
    return build_detection(np.stack(labellings), *fitted, picture.size_px)


def _search(
    grey: UInt8[np.ndarray, "h w"], board: Chessboard, tuning: CalibTuning
) -> Float[np.ndarray, "n 2"] | None:
    """Corners row by row, each within some pixels; None where no search finds the board.

    Large images are searched at a smaller size first: corners are refined in the image itself.
    """
    scale = min(1.0, np.sqrt(tuning.detection.most_searched_px / grey.size))
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale,
                                                 interpolation=cv2.INTER_AREA)  # fmt: skip
    share, best, most = tuning.detection.first_out_of_place_share, None, 0
    grid_mm = board.centres_mm
    for image in (small,) if small is grey else (small, grey):
        for corners in _searches(image, (board.columns, board.rows)):
            # The middle of the first pixel is the origin at both sizes.
            corners_px = (corners + 0.5) * (grey.shape[1] / image.shape[1]) - 0.5
            right = are_in_place(grid_mm, corners_px, share, tuning)
            if right.sum() > most:
                best, most = corners_px, int(right.sum())
            if right.all():
                return corners_px
        if best is not None and most >= tuning.detection.least_right_share * len(grid_mm):
            return _move_into_place(grid_mm, best, tuning)
    return None


def _searches(
    grey: UInt8[np.ndarray, "h w"], size: tuple[int, int]
) -> Iterator[Float[np.ndarray, "_n 2"]]:
    """The corners by each search that finds any, in the order in which searches are right most
    often on public image sets, which is also that of their time.

    The exhaustive search takes ten times as long: it is tried where a look at the image finds
    squares.
    """
    found, corners = cv2.findChessboardCorners(grey, size, flags=_CLASSIC)
    if found:
        yield np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE, _EXHAUSTIVE):
        if flags == _EXHAUSTIVE and not cv2.checkChessboard(grey, size):
            return
        found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if found:
            yield np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _move_into_place(
    board_mm: Float[np.ndarray, "n 2"], corners_px: Float[np.ndarray, "n 2"], tuning: CalibTuning
) -> Float[np.ndarray, "n 2"]:
    """The corners, with those that are something else moved to where their neighbours put them."""
    moved = corners_px.copy()
    right = are_in_place(board_mm, corners_px, tuning.detection.first_out_of_place_share, tuning)
    for wrong in np.flatnonzero(~right):
        rows = np.append(np.flatnonzero(right), wrong)
        moved[wrong] = predict_from_neighbours(board_mm[rows], corners_px[rows]).px[-1]
    return moved


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
    """Mean grey level of the light inner squares less that of the dark ones."""
    places = corners_px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (places[:-1, :-1] + places[1:, :-1] + places[:-1, 1:] + places[1:, 1:])
    column, row = np.rint(middles).astype(int).reshape(-1, 2).T
    level = grey[row, column].astype(float)
    dark = dark_squares(board.rows - 1, board.columns - 1).ravel()
    return float(level[~dark].mean() - level[dark].mean())
