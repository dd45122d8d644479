"""Entry points of the detection: the detector of each kind of board, and of sets of boards."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.chessboard import detect_chessboard
from trinoc.calib.detection.circles import detect_circles
from trinoc.calib.detection.detection import Detection, build_detection
from trinoc.calib.detection.marker_boards import detect_april_grid, detect_charuco
from trinoc.calib.detection.marker_readings import ReadingSearch
from trinoc.calib.detection.usable_points import remove_unusable
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.board_set import BoardSet, first_point_indices
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import DetectionError, InputError
from trinoc.image.grey import describe_mixed_pixels, grey_image

DETECTORS: dict[type[AbstractTarget], Callable[..., Detection]] = {
    Pattern: detect_circles,
    Chessboard: detect_chessboard,
    Charuco: detect_charuco,
    AprilGrid: detect_april_grid,
}


def detect_target(
    image: Shaped[np.ndarray, "..."], target: AbstractTarget, *, tuning: CalibTuning = TUNING
) -> Detection:
    """Detect the labelled points of a board or of a set of boards in one image.

    Parameters
    ----------
    image : (height, width) or (height, width, channels) array, 8 or 16 bit or floating point.
    target : a board or a set of boards.
    tuning : tuned constants of calibration; those of the detection are in `tuning.detection`.

    Returns
    -------
    Labelled points with positions and covariances.

    Raises
    ------
    InputError : `image` is no image, or no detector exists for this kind of board.
    DetectionError : the board is not detected, or the image is unusable: an interlaced image, whose
        rows are from two moments, or a raw colour mosaic. If the image shows a board of markers
        with a similar layout, the message describes this board.
    """
    return detect_or_explain(image, target, ReadingSearch(target, tuning=tuning), tuning=tuning)


def detect_or_explain(
    image: Shaped[np.ndarray, "..."],
    target: AbstractTarget,
    search: ReadingSearch | None,
    camera: str = "",
    *,
    tuning: CalibTuning = TUNING,
) -> Detection:
    """Detect a board like `detect_target`; the images of a recording share one layout search.

    Parameters
    ----------
    image, target, tuning : see `detect_target`.
    search : search for the true layout of a board that is not detected. It remembers its results
        for later images. None for no search.
    camera : name of the camera.
    """
    mixed = describe_mixed_pixels(grey_image(np.asarray(image)))
    if mixed is not None:
        raise DetectionError(mixed)
    try:
        return _detect(image, target, tuning)
    except DetectionError:
        reading = None if search is None else search.find(image, camera)
        if reading is None:
            raise
    raise DetectionError(reading.sentence)


def _detect(
    image: Shaped[np.ndarray, "..."], target: AbstractTarget, tuning: CalibTuning
) -> Detection:
    if isinstance(target, BoardSet):
        return _detect_board_set(image, target, tuning)
    if type(target) not in DETECTORS:
        raise InputError(
            f"A {type(target).__name__} cannot be detected: give a Pattern, a Chessboard, a "
            "Charuco, an AprilGrid or a BoardSet."
        )
    # Overflows are detected by `remove_unusable`.
    with np.errstate(all="ignore"):
        return remove_unusable(DETECTORS[type(target)](image, target, tuning), target, tuning)


def detect_pattern(
    image: Shaped[np.ndarray, "..."], pattern: Pattern, *, tuning: CalibTuning = TUNING
) -> Detection:
    """Detect the circles and crossed lines of a sheet in one image.

    Circles may be missing, covered or cut by the image border, if the visible rings determine the
    labelling. A symmetric pattern, such as a plain grid of discs, has several labellings. The first
    is the labelling whose X axis points most to the right in the image; the others are in
    `Detection.ambiguity`.

    Parameters
    ----------
    image : (height, width) or (height, width, channels) array, 8 or 16 bit or floating point.
    pattern : the sheet.
    tuning : tuned constants of calibration.

    Raises
    ------
    InputError : `image` is no image, or `pattern` has no plane lattice.
    DetectionError : the image shows no sheet, two sheets, a mirrored sheet, another pattern, or too
        little of the sheet.
    """
    return detect_target(image, pattern, tuning=tuning)


def _detect_board_set(
    image: Shaped[np.ndarray, "..."], boards: BoardSet, tuning: CalibTuning
) -> Detection:
    """Detect the points of all visible boards of a set.

    The crossed lines are omitted, because `Detection.lines_px` contains no index of the board.

    Raises
    ------
    DetectionError : no board is detected.
    """
    parts, labels, failures = [], [], []
    for first, board in zip(first_point_indices(boards), boards.boards, strict=True):
        try:
            part = _detect(image, board, tuning)
        except DetectionError as error:
            failures.append(str(error))
            continue
        parts.append(part)
        labels.append(first + part.labellings)
    if not parts:
        raise DetectionError(
            f"None of the boards {', '.join(boards.names)} was found. Reason for the first board: "
            f"{failures[0]}"
        )
    return build_detection(
        np.stack([np.concatenate(labelling) for labelling in product(*labels)]),
        np.concatenate([part.centres_px for part in parts]),
        np.concatenate([part.covariance_px2 for part in parts]),
        parts[0].image_size_px,
        np.concatenate([part.shape_px2 for part in parts]),
        remarks=tuple(remark for part in parts for remark in part.remarks),
    )
