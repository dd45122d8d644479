"""Detection of chessboards: OpenCV's searches, labelling by the colours of the squares.

References
----------
V. Vezhnevets' search for quadrangles (`cv2.findChessboardCorners`).
A. Duda and U. Frese, "Accurate detection and localization of checkerboard corners for
calibration", BMVC 2018 (`cv2.findChessboardCornersSB`).
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
    """Detect all inner corners of a chessboard, which must be completely visible.

    If a rotation maps the colours of the board onto themselves, several labellings are possible.
    The first is the one whose X axis points most to the right; `Detection.ambiguity` has the
    others. This also applies to a board whose top left square is light. A mirrored chessboard
    cannot be recognised.

    Raises
    ------
    DetectionError : the image shows no such board.
    """
    search_input = search_image(image)
    grey = levels_of_8_bit(search_input.grey)
    corners_px = _search(grey, board, tuning)
    if corners_px is None:
        raise DetectionError(
            f"No chessboard {board.name!r} of {board.rows} x {board.columns} inner corners was "
            "found in the image; show the whole board in focus, with a light margin around the "
            "board."
        )
    orders = _orders_from_front(corners_px, board)
    matching = [order for order in orders if _light_over_dark(grey, corners_px[order], board) > 0]
    labellings = sorted(
        (np.argsort(order) for order in matching or orders),
        key=lambda index: -rightward_share(corners_px, board.centres_mm[index]),
    )
    # The search is wrong by some tenths of a pixel in outer rows of oblique boards.
    fitted = refine_corners(search_input, grey, corners_px, distances_to_next(corners_px), tuning)
    return build_detection(np.stack(labellings), *fitted, search_input.size_px)


def _search(
    grey: UInt8[np.ndarray, "h w"], board: Chessboard, tuning: CalibTuning
) -> Float[np.ndarray, "n 2"] | None:
    """Corner positions row by row, accurate to some pixels; None if all searches fail.

    A large image is searched at reduced size first.
    """
    scale = min(1.0, np.sqrt(tuning.detection.most_searched_px / grey.size))
    small = grey if scale == 1.0 else cv2.resize(grey, None, fx=scale, fy=scale,
                                                 interpolation=cv2.INTER_AREA)  # fmt: skip
    share, best, best_count = tuning.detection.first_out_of_place_share, None, 0
    grid_mm = board.centres_mm
    for image in (small,) if small is grey else (small, grey):
        for corners in _searches(image, (board.columns, board.rows)):
            # The origin is the centre of the first pixel at both sizes.
            corners_px = (corners + 0.5) * (grey.shape[1] / image.shape[1]) - 0.5
            right = are_in_place(grid_mm, corners_px, share, tuning)
            if right.sum() > best_count:
                best, best_count = corners_px, int(right.sum())
            if right.all():
                return corners_px
        if best is not None and best_count >= tuning.detection.least_right_share * len(grid_mm):
            return _correct_outliers(grid_mm, best, tuning)
    return None


def _searches(
    grey: UInt8[np.ndarray, "h w"], size: tuple[int, int]
) -> Iterator[Float[np.ndarray, "_n 2"]]:
    """Yield the corner positions of each successful search.

    The order is that of success on public image sets, and also of computing time. The exhaustive
    search takes ten times as long: it runs only if a quick check detects squares.
    """
    is_found, corners = cv2.findChessboardCorners(grey, size, flags=_CLASSIC)
    if is_found:
        yield np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    for flags in (0, cv2.CALIB_CB_NORMALIZE_IMAGE, _EXHAUSTIVE):
        if flags == _EXHAUSTIVE and not cv2.checkChessboard(grey, size):
            return
        is_found, corners = cv2.findChessboardCornersSB(grey, size, flags=flags)
        if is_found:
            yield np.asarray(corners, dtype=np.float64).reshape(-1, 2)


def _correct_outliers(
    board_mm: Float[np.ndarray, "n 2"], corners_px: Float[np.ndarray, "n 2"], tuning: CalibTuning
) -> Float[np.ndarray, "n 2"]:
    """Corners with each inconsistent one replaced by the prediction of its neighbours."""
    moved = corners_px.copy()
    right = are_in_place(board_mm, corners_px, tuning.detection.first_out_of_place_share, tuning)
    for wrong in np.flatnonzero(~right):
        rows = np.append(np.flatnonzero(right), wrong)
        moved[wrong] = predict_from_neighbours(board_mm[rows], corners_px[rows]).px[-1]
    return moved


def _orders_from_front(
    corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> list[Int[np.ndarray, "_n"]]:
    """Possible orders of the detected corners, for a board seen from its front.

    One permutation per rotation: entry i is the detected corner at corner i of the board.
    """
    grid = np.arange(len(corners_px)).reshape(board.rows, board.columns)
    rows_px = corners_px.reshape(board.rows, board.columns, 2)
    across = np.mean(rows_px[:, -1] - rows_px[:, 0], axis=0)
    down = np.mean(rows_px[-1] - rows_px[0], axis=0)
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    turned = [np.rot90(grid, quarters) for quarters in range(4)]
    return [rotated.ravel() for rotated in turned if rotated.shape == grid.shape]


def _light_over_dark(
    grey: UInt8[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> float:
    """Mean grey level of the light inner squares minus that of the dark ones."""
    rows_px = corners_px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (rows_px[:-1, :-1] + rows_px[1:, :-1] + rows_px[:-1, 1:] + rows_px[1:, 1:])
    column, row = np.rint(middles).astype(int).reshape(-1, 2).T
    level = grey[row, column].astype(float)
    dark = dark_squares(board.rows - 1, board.columns - 1).ravel()
    return float(level[~dark].mean() - level[dark].mean())
