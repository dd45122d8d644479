"""The detector that belongs to each kind of board."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.chessboard import detect_chessboard
from trinoc.calib.detection.circles import detect_circles
from trinoc.calib.detection.detection import Detection, detect_board_set
from trinoc.calib.detection.marker_boards import detect_april_grid, detect_charuco
from trinoc.calib.targets import AbstractTarget, AprilGrid, BoardSet, Charuco, Chessboard, Pattern
from trinoc.errors import InputError

DETECTORS: dict[type[AbstractTarget], Callable[..., Detection]] = {
    Pattern: detect_circles,
    Chessboard: detect_chessboard,
    Charuco: detect_charuco,
    AprilGrid: detect_april_grid,
}


def detect_target(image: Shaped[np.ndarray, "..."], target: AbstractTarget) -> Detection:
    """The labelled places of a board, or of a set of boards, in one picture, with covariances.

    image : (height, width) or (height, width, channels), 8 or 16 bit or real numbers.

    Raises
    ------
    InputError : `image` is no picture, or nothing detects such a target.
    DetectionError : the board is not seen, or not in a way that can be trusted.
    """
    if isinstance(target, BoardSet):
        return detect_board_set(image, target, detect_target)
    for board, detect in DETECTORS.items():
        if isinstance(target, board):
            return detect(image, target)
    raise InputError(
        f"Nothing detects a {type(target).__name__}: give a Pattern, a Chessboard, a Charuco, an "
        "AprilGrid or a BoardSet."
    )


def detect_pattern(image: Shaped[np.ndarray, "..."], pattern: Pattern) -> Detection:
    """`detect_target` of a sheet of circles.

    Circles may be missing, covered, or cut by the border as long as the rings seen tell where
    the sheet lies. A pattern whose own symmetry leaves more than one labelling open (a plain
    grid of discs) is labelled as if X pointed right, as nearly as it can; the other choices
    stand in `Detection.ambiguity`.

    Raises
    ------
    InputError : `image` is no picture, or `pattern` has no plane lattice.
    DetectionError : no sheet is seen, or two, or a mirrored one, or another pattern, or too
        little of it to tell where it lies.
    """
    return detect_target(image, pattern)
