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
from trinoc.calib.detection.detection import Detection, build_detection, rightward_cosine
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
    The first is the labelling whose X axis points most to the right in the image; the others are in
    `Detection.ambiguity`. A board whose top left square is light, contrary to `Chessboard`, has
    several labellings as well. A mirrored chessboard cannot be recognised.

    Parameters
    ----------
    image : grey or colour image.
    board : the chessboard.
    tuning : tuned constants of calibration.

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
    matching = [order for order in orders if _light_minus_dark(grey, corners_px[order], board) > 0]
    labellings = sorted(
        (np.argsort(order) for order in matching or orders),
        key=lambda index: -rightward_cosine(corners_px, board.centres_mm[index]),
    )
    # The search is wrong by some tenths of a pixel in outer rows of oblique boards.
    fitted = refine_corners(search_input, grey, corners_px, distances_to_next(corners_px), tuning)
    return build_detection(np.stack(labellings), *fitted, search_input.size_px)


def _search(
    grey: UInt8[np.ndarray, "h w"], board: Chessboard, tuning: CalibTuning
) -> Float[np.ndarray, "n 2"] | None:
    """Approximate corner positions row by row, px; None if no search succeeds.

    A large image is first searched at reduced size. The errors are up to some pixels.
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
            in_place = are_in_place(grid_mm, corners_px, share, tuning)
            if in_place.sum() > best_count:
                best, best_count = corners_px, int(in_place.sum())
            if in_place.all():
                return corners_px
        if best is not None and best_count >= tuning.detection.least_right_share * len(grid_mm):
            return _correct_outliers(grid_mm, best, tuning)
    return None


def _searches(
    grey: UInt8[np.ndarray, "h w"], size: tuple[int, int]
) -> Iterator[Float[np.ndarray, "_n 2"]]:
    """Yield the corner positions of each OpenCV search that succeeds.

    The searches with the highest success rate on public image sets come first, which are also the
    fastest. The exhaustive search takes ten times as long. It runs only if a quick test detects
    squares.

    size : (columns, rows) of corners.
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
    """Corner positions in which predictions from the neighbours replace outliers."""
    corrected_px = corners_px.copy()
    in_place = are_in_place(board_mm, corners_px, tuning.detection.first_out_of_place_share, tuning)
    for outlier in np.flatnonzero(~in_place):
        rows = np.append(np.flatnonzero(in_place), outlier)
        corrected_px[outlier] = predict_from_neighbours(board_mm[rows], corners_px[rows]).px[-1]
    return corrected_px


def _orders_from_front(
    corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> list[Int[np.ndarray, "_n"]]:
    """Possible orders of the detected corners for a board seen from its front.

    Each order is a permutation for one rotation of the board: entry i is the index of the detected
    corner that is corner i of the board.
    """
    grid = np.arange(len(corners_px)).reshape(board.rows, board.columns)
    rows_px = corners_px.reshape(board.rows, board.columns, 2)
    across = np.mean(rows_px[:, -1] - rows_px[:, 0], axis=0)
    down = np.mean(rows_px[-1] - rows_px[0], axis=0)
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    turned = [np.rot90(grid, quarters) for quarters in range(4)]
    return [rotated.ravel() for rotated in turned if rotated.shape == grid.shape]


def _light_minus_dark(
    grey: UInt8[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> float:
    """Mean grey level of the light inner squares minus that of the dark inner squares."""
    rows_px = corners_px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (rows_px[:-1, :-1] + rows_px[1:, :-1] + rows_px[:-1, 1:] + rows_px[1:, 1:])
    column, row = np.rint(middles).astype(int).reshape(-1, 2).T
    level = grey[row, column].astype(float)
    dark = dark_squares(board.rows - 1, board.columns - 1).ravel()
    return float(level[~dark].mean() - level[dark].mean())
