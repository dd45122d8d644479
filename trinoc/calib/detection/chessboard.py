"""The corners of a chessboard, by OpenCV's sector-based search, labelled by its colours.

Source: A. Duda and U. Frese, "Accurate detection and localization of checkerboard corners for
calibration", BMVC 2018 (`cv2.findChessboardCornersSB`).
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8

from trinoc.calib.detection.corner_accuracy import corner_covariance_px2
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.grey import search_image
from trinoc.calib.targets import Chessboard, dark_squares
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
    chessboard is a chessboard: nothing in one picture tells.

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
    labelled = _labellings(corners_px, board)
    agreement = [_agreement(grey, corners_px[index], board) for index in labelled]
    right = [index for index, agrees in zip(labelled, agreement, strict=True) if agrees > 0]
    if not right:
        raise DetectionError(
            f"The squares of the chessboard {board.name!r} are not dark and light in turn as its "
            "layout has them; check the numbers of its corners."
        )
    first, *others = sorted((np.argsort(index) for index in right), key=lambda index: -_rightward(
        corners_px, board.centres_mm[index]))  # fmt: skip
    return Detection(
        circle_index=first,
        centres_px=corners_px,
        covariance_px2=corner_covariance_px2(picture, corners_px),
        shape_px2=np.full((len(corners_px), 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=picture.size_px,
        ambiguity=np.stack(others) if others else None,
    )


def levels_of_8_bit(grey: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Grey levels between the darkest and the lightest as OpenCV's detectors take them."""
    low, high = float(grey.min()), float(grey.max())
    if low >= 0.0 and 127.0 < high <= 255.0:
        low, high = 0.0, 255.0
    scale = 255.0 / max(high - low, 1e-9)
    return np.clip(np.rint((grey - low) * scale), 0, 255).astype(np.uint8)


def _labellings(
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


def _agreement(
    grey: UInt8[np.ndarray, "h w"], corners_px: Float[np.ndarray, "n 2"], board: Chessboard
) -> float:
    """How much lighter the light inner squares are than the dark ones."""
    places = corners_px.reshape(board.rows, board.columns, 2)
    middles = 0.25 * (places[:-1, :-1] + places[1:, :-1] + places[:-1, 1:] + places[1:, 1:])
    dark: Bool[np.ndarray, "r c"] = dark_squares(board.rows + 1, board.columns + 1)[1:-1, 1:-1]
    column, row = np.rint(middles).astype(int).reshape(-1, 2).T
    level = grey[np.clip(row, 0, grey.shape[0] - 1), np.clip(column, 0, grey.shape[1] - 1)].astype(
        float
    )
    return float(level[~dark.ravel()].mean() - level[dark.ravel()].mean())


def _rightward(
    corners_px: Float[np.ndarray, "n 2"], on_board_mm: Float[np.ndarray, "n 2"]
) -> float:
    """The share of X's direction in the picture that points to the right."""
    affine, *_ = np.linalg.lstsq(
        on_board_mm - on_board_mm.mean(axis=0), corners_px - corners_px.mean(axis=0), rcond=None
    )
    return float(affine[0, 0] / np.linalg.norm(affine[0]))
