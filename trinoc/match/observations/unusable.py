"""Segments that are left out before anything is matched: no matcher can tell what they say.

A segment whose place across itself is hardly known, as that of a saturated edge may be, passes the
gates of every line. Equal segments of one view are one observation that was stated more than once:
n of them in each of three views make n^3 candidates, none of which can be told from the others.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.match.observations.match_input import FrameInput
from trinoc.match.observations.table import project_covariance_across
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import ObservationTuning
from trinoc.numerics.joins import group_labels

UNPLACED = "not placed across itself"
EQUAL = "equal to another segment"
# numerical: the nearest of each that are compared at a time; where more are equal, in more rounds.
_NEAREST = 8


def leave_out_unusable(
    frame: FrameInput, tuning: ObservationTuning = DEFAULT.observations
) -> FrameInput:
    """The frame without such segments; `left_out` says of the caller's segments why."""
    kept, words = [], []
    for order, ends, covariance, polarity, left_out in zip(
        frame.order,
        frame.ends_px,
        frame.covariance_px2,
        frame.polarity,
        frame.left_out,
        strict=True,
    ):
        sigma = sigma_across_px(ends, covariance)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        placed = np.flatnonzero(sigma < np.minimum(tuning.largest_across_px, length))
        single = placed[first_of_equals(ends[placed], sigma[placed], polarity[placed], tuning)]
        why = np.full(len(ends), UNPLACED, dtype="U40")
        why[placed], why[single] = EQUAL, ""
        kept.append(single)
        of_given = left_out.astype("U40")
        of_given[order] = why
        words.append(of_given)
    columns = {
        name: [column[rows] for column, rows in zip(getattr(frame, name), kept, strict=True)]
        for name in ("order", "ends_px", "covariance_px2", "polarity", "sides")
    }
    return frame._replace(**columns, left_out=words)


def sigma_across_px(
    ends_px: Float[np.ndarray, "n 2 2"], covariance_px2: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n"]:
    """Standard deviation of each segment across itself, px, at the end where it is larger."""
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(step, axis=1, keepdims=True)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / length
    variance = np.diagonal(project_covariance_across(normal, covariance_px2), axis1=1, axis2=2)
    return np.sqrt(variance.max(axis=1))


def first_of_equals(
    ends_px: Float[np.ndarray, "n 2 2"],
    sigma_px: Float[np.ndarray, "n"],
    polarity: Int[np.ndarray, "n"],
    tuning: ObservationTuning = DEFAULT.observations,
) -> Int[np.ndarray, "k"]:
    """Rows without those whose ends agree, within a share of their sigma across, with those of an
    earlier one of the same or of no polarity."""
    rows = np.arange(len(ends_px))
    while len(rows) > 1:
        first, second = _equal_pairs(
            ends_px[rows].reshape(-1, 4), tuning.equal_sigmas * sigma_px[rows], polarity[rows]
        )
        label = group_labels(len(rows), first, second)
        if len(first) == 0:
            break
        rows = rows[label == np.arange(len(rows))]
    return rows


def _equal_pairs(
    places: Float[np.ndarray, "n 4"], reach: Float[np.ndarray, "n"], polarity: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """(i, j) of some of the equal rows: of each, among the nearest."""
    most = min(_NEAREST, len(places))
    distance, near = KDTree(places).query(places, k=most, distance_upper_bound=reach.max())
    i, slot = np.nonzero(np.isfinite(np.asarray(distance)))
    j = np.asarray(near)[i, slot]
    are_equal: Bool[np.ndarray, "p"] = np.asarray(distance)[i, slot] <= np.minimum(
        reach[i], reach[j]
    )
    are_equal &= (i != j) & (polarity[i] * polarity[j] >= 0)
    return i[are_equal], j[are_equal]
