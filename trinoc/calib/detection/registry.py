"""The detector that belongs to each kind of board."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.chessboard import detect_chessboard
from trinoc.calib.detection.circles import detect_circles
from trinoc.calib.detection.detection import Detection, build_detection
from trinoc.calib.detection.marker_boards import detect_april_grid, detect_charuco
from trinoc.calib.detection.marker_readings import ReadingSearch
from trinoc.calib.detection.usable_places import keep_usable
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
    """The labelled places of a board, or of a set of boards, in one picture, with covariances.

    image : (height, width) or (height, width, channels), 8 or 16 bit or real numbers.
    tuning : all tuned constants; `tuning.detection` has those of the search.

    Raises
    ------
    InputError : `image` is no picture, or nothing detects such a target.
    DetectionError : the board is not seen, or not in a way that can be trusted: rows that are of
        two moments place it between them, pixels of several colours beside it. Where the picture
        shows a board with markers that is almost this one, the sentence says which.
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
    """`detect_target` with a search for other readings of the board that other images share.

    search : None for no search. camera : whose image it is.
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
            f"Nothing detects a {type(target).__name__}: give a Pattern, a Chessboard, a Charuco, "
            "an AprilGrid or a BoardSet."
        )
    # Numbers that overflow are found below, whatever they came from.
    with np.errstate(all="ignore"):
        return keep_usable(DETECTORS[type(target)](image, target, tuning), target, tuning)


def detect_pattern(
    image: Shaped[np.ndarray, "..."], pattern: Pattern, *, tuning: CalibTuning = TUNING
) -> Detection:
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
    return detect_target(image, pattern, tuning=tuning)


def _detect_board_set(
    image: Shaped[np.ndarray, "..."], boards: BoardSet, tuning: CalibTuning
) -> Detection:
    """The places of all boards of a set that the picture shows.

    Lines are left out: of several boards they would not say whose they are. Raises DetectionError
    where no board is found.
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
            f"None of the boards {', '.join(boards.names)} was found; of the first: {failures[0]}"
        )
    return build_detection(
        np.stack([np.concatenate(each) for each in product(*labels)]),
        np.concatenate([part.centres_px for part in parts]),
        np.concatenate([part.covariance_px2 for part in parts]),
        parts[0].image_size_px,
        np.concatenate([part.shape_px2 for part in parts]),
        remarks=tuple(remark for part in parts for remark in part.remarks),
    )
