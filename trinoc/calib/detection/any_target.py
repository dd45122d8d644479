"""The detector that belongs to a board."""

import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.april_grid import detect_april_grid
from trinoc.calib.detection.board_set import detect_board_set
from trinoc.calib.detection.charuco import detect_charuco
from trinoc.calib.detection.chessboard import detect_chessboard
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.search import detect_pattern
from trinoc.calib.targets import AbstractTarget, AprilGrid, BoardSet, Charuco, Chessboard, Pattern
from trinoc.errors import InputError


def detect_target(image: Shaped[np.ndarray, "..."], target: AbstractTarget) -> Detection:
    """The labelled places of a board, or of a set of boards, in one picture, with covariances.

    image : (height, width) or (height, width, channels), 8 or 16 bit or real numbers.

    Raises
    ------
    InputError : `image` is no picture, or nothing detects such a target.
    DetectionError : the board is not seen, or not in a way that can be trusted.
    """
    match target:
        case Pattern():
            return detect_pattern(image, target)
        case Chessboard():
            return detect_chessboard(image, target)
        case Charuco():
            return detect_charuco(image, target)
        case AprilGrid():
            return detect_april_grid(image, target)
        case BoardSet():
            return detect_board_set(image, target, detect_target)
    raise InputError(
        f"Nothing detects a {type(target).__name__}: give a Pattern, a Chessboard, a Charuco, an "
        "AprilGrid or a BoardSet."
    )
