"""Exclude segments that carry no information, before matching.

A segment with a very uncertain position across itself passes the gates of every line. Saturated
edges may give such segments. Equal segments of one view are one observation stated several
times: n of them in each of three views give n^3 indistinguishable candidates.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from trinoc.match.observations.match_input import FrameInput
from trinoc.match.observations.table import project_covariance_across
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import ObservationTuning
from trinoc.numerics.joins import group_labels

POSITION_UNKNOWN = "not placed across itself"
DUPLICATE = "equal to another segment"
# numerical: number of neighbours compared per round. More duplicates need more rounds.
_NEAREST = 8


def exclude_unusable(
    frame: FrameInput, tuning: ObservationTuning = DEFAULT.observations
) -> FrameInput:
    """Return the frame without segments that are too uncertain or that duplicate another segment.

    `exclusion_reasons` of the result contains the reason for each excluded segment.
    """
    selected_rows, all_reasons = [], []
    for order, ends, covariance, polarity, view_reasons in zip(
        frame.order,
        frame.ends_px,
        frame.covariance_px2,
        frame.polarity,
        frame.exclusion_reasons,
        strict=True,
    ):
        sigma = sigma_across_px(ends, covariance)
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        located = np.flatnonzero(sigma < np.minimum(tuning.max_sigma_across_px, length))
        distinct = located[
            first_of_duplicates(ends[located], sigma[located], polarity[located], tuning)
        ]
        reasons = np.full(len(ends), POSITION_UNKNOWN, dtype="U40")
        reasons[located], reasons[distinct] = DUPLICATE, ""
        selected_rows.append(distinct)
        reasons_of_view = view_reasons.astype("U40")
        reasons_of_view[order] = reasons
        all_reasons.append(reasons_of_view)
    columns = {
        name: [
            column[rows] for column, rows in zip(getattr(frame, name), selected_rows, strict=True)
        ]
        for name in ("order", "ends_px", "covariance_px2", "polarity", "sides")
    }
    return frame._replace(**columns, exclusion_reasons=all_reasons)


def sigma_across_px(
    ends_px: Float[np.ndarray, "n 2 2"], covariance_px2: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n"]:
    """Return the standard deviation across each segment, at its less precise end, (n,) px."""
    step = ends_px[:, 1] - ends_px[:, 0]
    length = np.linalg.norm(step, axis=1, keepdims=True)
    normal = np.stack([-step[:, 1], step[:, 0]], axis=1) / length
    variance = np.diagonal(project_covariance_across(normal, covariance_px2), axis1=1, axis2=2)
    return np.sqrt(variance.max(axis=1))


def first_of_duplicates(
    ends_px: Float[np.ndarray, "n 2 2"],
    sigma_px: Float[np.ndarray, "n"],
    polarity: Int[np.ndarray, "n"],
    tuning: ObservationTuning = DEFAULT.observations,
) -> Int[np.ndarray, "k"]:
    """Return the indices of the segments that do not duplicate an earlier segment, (k,).

    Two segments are duplicates if their ends coincide within a fraction of their sigma across the
    segment, and their polarities are not opposite.
    """
    rows = np.arange(len(ends_px))
    while len(rows) > 1:
        first, second = _duplicate_pairs(
            ends_px[rows].reshape(-1, 4), tuning.duplicate_sigmas * sigma_px[rows], polarity[rows]
        )
        label = group_labels(len(rows), first, second)
        if len(first) == 0:
            break
        rows = rows[label == np.arange(len(rows))]
    return rows


def _duplicate_pairs(
    positions: Float[np.ndarray, "n 4"],
    radius: Float[np.ndarray, "n"],
    polarity: Int[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Return pairs of duplicate segments, as two arrays of indices.

    Only the nearest segments of each segment are compared, so some pairs are missing. `positions`
    are the four coordinates of the ends.
    """
    neighbours = min(_NEAREST, len(positions))
    distance, nearest = KDTree(positions).query(
        positions, k=neighbours, distance_upper_bound=radius.max()
    )
    i, slot = np.nonzero(np.isfinite(np.asarray(distance)))
    j = np.asarray(nearest)[i, slot]
    is_duplicate: Bool[np.ndarray, "p"] = np.asarray(distance)[i, slot] <= np.minimum(
        radius[i], radius[j]
    )
    is_duplicate &= (i != j) & (polarity[i] * polarity[j] >= 0)
    return i[is_duplicate], j[is_duplicate]
