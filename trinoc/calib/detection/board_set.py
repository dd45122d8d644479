"""Several boards in one picture: found one by one, and one detection of them all."""

from collections.abc import Callable
from itertools import product

import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets import AbstractTarget, BoardSet, first_places
from trinoc.errors import DetectionError

Detector = Callable[[Shaped[np.ndarray, "..."], AbstractTarget], Detection]


def detect_board_set(
    image: Shaped[np.ndarray, "..."], target: BoardSet, detect: Detector
) -> Detection:
    """The places of all boards of a set that the picture shows, by `detect`.

    Lines are not told: of several boards they would not say whose they are. Raises DetectionError
    where no board is found.
    """
    found, failures = [], []
    for first, board in zip(first_places(target), target.boards, strict=True):
        try:
            found.append((first, detect(image, board)))
        except DetectionError as error:
            failures.append(str(error))
    if not found:
        raise DetectionError(
            f"None of the boards {', '.join(target.names)} was found; of the first: {failures[0]}"
        )
    labels = [[first + index for index in _labellings(own)] for first, own in found]
    (index, *others) = (np.concatenate(each) for each in product(*labels))
    detections = [own for _, own in found]
    return Detection(
        circle_index=index,
        centres_px=np.concatenate([own.centres_px for own in detections]),
        covariance_px2=np.concatenate([own.covariance_px2 for own in detections]),
        shape_px2=np.concatenate([own.shape_px2 for own in detections]),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=detections[0].image_size_px,
        ambiguity=np.stack(others) if others else None,
    )


def split_by_board(detection: Detection, target: AbstractTarget) -> dict[int, Detection]:
    """What was found of each board, by its number; a place keeps its index in the whole set."""
    if not isinstance(target, BoardSet):
        return {0: detection}
    board_of = target.board_of_place[detection.circle_index]
    return {
        int(board): _part(detection, np.flatnonzero(board_of == board))
        for board in np.unique(board_of)
    }


def _part(detection: Detection, rows: np.ndarray) -> Detection:
    labellings = np.stack([index[rows] for index in _labellings(detection)])
    _, first = np.unique(labellings, axis=0, return_index=True)
    index, *others = labellings[np.sort(first)]
    return Detection(
        circle_index=index,
        centres_px=detection.centres_px[rows],
        covariance_px2=detection.covariance_px2[rows],
        shape_px2=detection.shape_px2[rows],
        lines_px=detection.lines_px,
        image_size_px=detection.image_size_px,
        ambiguity=np.stack(others) if others else None,
    )


def _labellings(detection: Detection) -> list[np.ndarray]:
    """All, the first one first."""
    others = [] if detection.ambiguity is None else list(detection.ambiguity)
    return [detection.circle_index, *others]
