"""Patterns that repeat: the most that evidence can say where wrong partners fit as well as right.

The evidence compares one line with clutter, whose ends lie anywhere. Where a pattern repeats along
the epipolar lines, the partner one period off fits as well as the right one: place, ends, lengths
and junctions differ between them by noise alone, which says nothing. How often this is so is told
by the set itself: of the likeliest candidates about a place, how many have a rival that is nearly
as likely? Elsewhere few have one.

With the probability q that a place is of a pattern, the odds w of a track are against clutter and
against that pattern: w / (1 + q w / m), at most m / q. What is selected stays as it is: only how
sure it is changes, of triples and pairs alike.
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
    """Where a pattern may repeat: places of likely candidates in space, and the log odds against a
    pattern there.

    frame : of a stack, the frame of each.
    """

    middle_mm: Float[np.ndarray, "t 3"]
    greatest_log_odds: Float[np.ndarray, "t"]
    frame: Int[np.ndarray, "t"]


# numerical: nothing is known.
NO_REPETITION = Repetition(np.zeros((0, 3)), np.zeros(0), np.zeros(0, np.int32))


def find_repetition(
    candidates: Candidates,
    log_odds: Float[np.ndarray, "m"],
    graph: ConflictGraph,
    tuning: RepetitionTuning = DEFAULT.repetition,
) -> Repetition:
    """The likely candidates that no rival surpasses, and what those about each say."""
    rival_log_odds = np.full(len(log_odds), -np.inf)
    np.maximum.at(
        rival_log_odds, graph.slot // graph.views, log_odds[graph.rival_slot // graph.views]
    )
    rows = np.flatnonzero((log_odds > tuning.likely_log_odds) & (log_odds >= rival_log_odds))
    least = np.maximum(log_odds[rows] - tuning.nearly_log_odds, tuning.likely_log_odds)
    is_contested = rival_log_odds[rows] > least
    middle_mm = candidates.ends_mm[rows].mean(axis=1)
    frame = label_frames(candidates.frame, len(log_odds))[rows]
    greatest, (usual, repeated) = np.zeros(len(rows)), tuning.contested_shares
    for own in _of_each_frame(frame):
        count = min(tuning.neighbours, len(own))
        near = KDTree(middle_mm[own]).query(middle_mm[own], count)[1].reshape(-1, count)
        contested = is_contested[own][near].sum(axis=1)
        # The log odds of a pattern, by two binomial distributions.
        is_pattern = tuning.prior_log_odds + contested * np.log(repeated / usual)
        is_pattern += (count - contested) * np.log((1 - repeated) / (1 - usual))
        greatest[own] = tuning.greatest_log_odds + np.logaddexp(0, -is_pattern)
    return Repetition(middle_mm, greatest, frame)


def limit_log_odds(
    log_odds: Float[np.ndarray, "m"], greatest: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "m"]:
    """Log odds against clutter and against a pattern."""
    return -np.logaddexp(-log_odds, -greatest)


def greatest_log_odds(candidates: Candidates, repetition: Repetition) -> Float[np.ndarray, "m"]:
    """The log odds against a pattern of each candidate, those of the nearest place; infinite where
    nothing is known."""
    greatest = np.full(len(candidates.index), np.inf)
    frame = label_frames(candidates.frame, len(greatest))
    middle_mm = candidates.ends_mm.mean(axis=1)
    for own in _of_each_frame(repetition.frame):
        rows = np.flatnonzero(frame == repetition.frame[own[0]])
        nearest = KDTree(repetition.middle_mm[own]).query(middle_mm[rows])[1]
        greatest[rows] = repetition.greatest_log_odds[own][nearest]
    return greatest


def _of_each_frame(frame: Int[np.ndarray, "t"]) -> Iterator[Int[np.ndarray, "_"]]:
    return (np.flatnonzero(frame == each) for each in np.unique(frame))
