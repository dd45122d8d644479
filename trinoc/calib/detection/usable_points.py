"""Final check of every detection.

Positions are finite, covariances are finite, symmetric and positive definite, and corners agree
with their neighbours.
"""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection, build_detection
from trinoc.calib.detection.neighbour_check import are_in_place
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.errors import DetectionError


def remove_unusable(detection: Detection, target: AbstractTarget, tuning: CalibTuning) -> Detection:
    """Remove the points that a fit cannot use, and report their number in `Detection.remarks`.

    A point is unusable if its position or covariance is invalid, or if neighbouring corners
    contradict its position.

    Parameters
    ----------
    detection : points of the board.
    target : the board.
    tuning : tuned constants of calibration.

    Raises
    ------
    DetectionError : too few points remain.
    """
    symmetric = 0.5 * (detection.covariance_px2 + detection.covariance_px2.mT)
    usable = np.isfinite(detection.centres_px).all(axis=1) & are_positive(symmetric)
    remarks = []
    if not usable.all():
        remarks.append(f"{_count(~usable)} no finite position and sigma")
    rows = np.flatnonzero(usable)
    index = detection.circle_index[rows]
    if len(rows) and not np.any(target.radius_mm[index] > 0):
        in_place = are_in_place(
            target.centres_mm[index],
            detection.centres_px[rows],
            tuning.detection.out_of_place_share,
            tuning,
        )
        if not in_place.all():
            remarks.append(
                f"{_count(~in_place)} a position that contradicts the neighbouring points"
            )
        usable[rows[~in_place]] = False
    fewest = tuning.detection.fewest_places
    if not usable.all() and usable.sum() < fewest:
        raise DetectionError(
            f"Only {usable.sum()} of the {len(usable)} points found on the board {target.name!r} "
            f"can be used, and at least {fewest} are needed; check that the image is sharp, not "
            "overexposed, and shows this board."
        )
    return build_detection(
        detection.labellings[:, usable],
        detection.centres_px[usable],
        symmetric[usable],
        detection.image_size_px,
        detection.shape_px2[usable],
        detection.lines_px,
        tuple(remarks),
    )


def are_positive(covariance: Float[np.ndarray, "n k k"]) -> Bool[np.ndarray, "n"]:
    """Mask of the matrices that are finite and positive definite beyond rounding errors."""
    finite = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    values = np.linalg.eigvalsh(np.where(finite[:, None, None], covariance, 0.0))
    return finite & (values[:, 0] > 1e-12 * values[:, -1])


def _count(mask: Bool[np.ndarray, "n"]) -> str:
    """Return the first words of a remark, such as "3 of 54 points have"."""
    number = int(mask.sum())
    return f"{number} of {len(mask)} points {'has' if number == 1 else 'have'}"
