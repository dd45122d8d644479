"""Repeated patterns: limit the log odds of tracks whose wrong partners fit as well as the right
ones.

The evidence compares one line with clutter, whose ends lie anywhere. If a pattern repeats along the
epipolar lines, the partner one period off fits as well as the right one. Position, ends, lengths
and junctions then differ only by noise. The set itself shows how often this happens. The measure is
the share of the most likely candidates near a position that have a nearly equal rival.

Let q be the probability of a pattern at a position, and w the odds of a track. The odds against
clutter and pattern are then w / (1 + q w / m), at most m / q. The selection does not change.
Only the posteriors of triples and pairs do.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.candidates.table import Candidates
from trinoc.match.selection.messages import ConflictGraph, label_frames
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.selection import RepetitionTuning


class Repetition(NamedTuple):
    """Upper limits of the log odds in scenes with repeated patterns, at positions in space.

    Attributes
    ----------
    middle_mm : (t, 3)
        Positions: midpoints of likely candidates, world frame.
    greatest_log_odds : (t,)
        Upper limit of the log odds at each position.
    frame : (t,)
        Frame of each position in a stack.
    """

    middle_mm: Float[np.ndarray, "t 3"]
    greatest_log_odds: Float[np.ndarray, "t"]
    frame: Int[np.ndarray, "t"]


# numerical: no information on repeated patterns.
NO_REPETITION = Repetition(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32))


def find_repetition(
    candidates: Candidates,
    log_odds: Float[np.ndarray, "m"],
    graph: ConflictGraph,
    tuning: RepetitionTuning = DEFAULT.repetition,
) -> Repetition:
    """Estimate the upper limit of the log odds near each likely candidate that has no likelier
    rival.

    The limit is low where many nearby candidates have a rival that is nearly as likely.
    """
    rival_log_odds = np.full(len(log_odds), -np.inf)
    np.maximum.at(
        rival_log_odds, graph.slot // graph.views, log_odds[graph.rival_slot // graph.views]
    )
    rows = np.flatnonzero((log_odds > tuning.likely_log_odds) & (log_odds >= rival_log_odds))
    contest_limit = np.maximum(log_odds[rows] - tuning.contest_log_odds, tuning.likely_log_odds)
    is_contested = rival_log_odds[rows] > contest_limit
    middle_mm = candidates.ends_mm[rows].mean(axis=1)
    frame = label_frames(candidates.frame, len(log_odds))[rows]
    limit, (usual_share, pattern_share) = np.zeros(len(rows)), tuning.contested_shares
    for frame_rows in _rows_per_frame(frame):
        count = min(tuning.neighbours, len(frame_rows))
        nearest = (
            KDTree(middle_mm[frame_rows]).query(middle_mm[frame_rows], count)[1].reshape(-1, count)
        )
        contested = is_contested[frame_rows][nearest].sum(axis=1)
        # Log odds of a pattern: ratio of two binomial distributions.
        pattern_log_odds = tuning.prior_log_odds + contested * np.log(pattern_share / usual_share)
        pattern_log_odds += (count - contested) * np.log((1 - pattern_share) / (1 - usual_share))
        limit[frame_rows] = tuning.max_log_odds + np.logaddexp(0, -pattern_log_odds)
    return Repetition(middle_mm, limit, frame)


def limit_log_odds(
    log_odds: Float[np.ndarray, "m"], limit: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Combine log odds against clutter with the upper limit of a repeated pattern, (m,).

    With odds w and limit u, the result is the log of 1 / (1 / w + 1 / u).
    """
    return -np.logaddexp(-log_odds, -limit)


def greatest_log_odds(candidates: Candidates, repetition: Repetition) -> Float[np.ndarray, "m"]:
    """Return the upper limit of each candidate's log odds: that of the nearest position, (m,).

    The limit is inf in frames without positions.
    """
    limit = np.full(len(candidates.index), np.inf)
    frame = label_frames(candidates.frame, len(limit))
    middle_mm = candidates.ends_mm.mean(axis=1)
    for frame_rows in _rows_per_frame(repetition.frame):
        rows = np.flatnonzero(frame == repetition.frame[frame_rows[0]])
        nearest = KDTree(repetition.middle_mm[frame_rows]).query(middle_mm[rows])[1]
        limit[rows] = repetition.greatest_log_odds[frame_rows][nearest]
    return limit


def _rows_per_frame(frame: Int[np.ndarray, "t"]) -> Iterator[Int[np.ndarray, "_"]]:
    return (np.flatnonzero(frame == label) for label in np.unique(frame))
