"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. What makes a
pair is that its ends meet those of matched lines; so pairs of all views stand together with
the lines matched so far, and their beliefs are found like those of triples, to a fixed point.
"""

from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.arrays import ArrayLike
from trinoc.match.candidates import (
    TRIPLES_IN_BLOCK,
    Candidates,
    block_of,
    in_depth_range,
    joined_candidates,
    row_of,
    stacked,
)
from trinoc.match.ends import AGREEING_PX, PAIR_PX
from trinoc.match.evidence import (
    Habits,
    log_place,
    log_sides,
    probability,
    tempered,
    usual_habits,
    volume_of,
)
from trinoc.match.exclusivity import beliefs, chosen_greedily, claimed, conflicts
from trinoc.match.intervals import overlapping
from trinoc.match.likelihood import Strangers
from trinoc.match.merging import Tracks
from trinoc.match.neighbours import USUAL_HABITS, JunctionHabits, junctions, support
from trinoc.match.padding import in_blocks
from trinoc.match.pair_likelihood import PairEvidence, pair_evidence
from trinoc.match.pencil import Pencil, pencil
from trinoc.match.picture_lines import PictureLines
from trinoc.match.polarity import polarity_evidence
from trinoc.match.selection import HOPELESS_LEARNED, LEAST_JOINED, Selection
from trinoc.match.side_evidence import side_evidence

ROUNDS = 6
# With fewer lines than this in three views, nothing is learned from them.
FEW = 10
# A segment of which less than this is matched may be half of a pair.
FREE = 0.5
# Pairs before any is known, as a share of the lines matched in three views.
USUAL_SHARE = 0.1
# Log odds that a view misses a line within its borders.
LOG_MISSED = float(np.log(0.5))
# What the evidence of true pairs falls short of, on made scenes of other seeds (700,000 on): with
# it the share that is right is nearer to the stated one on four of five kinds of scene.
MISFIT = 2.25
# In pictures, where strangers are alike, it exceeds it instead: see `evidence.TEMPER`.
MISFIT_OF_PICTURES = -1.5


class _Possible(NamedTuple):
    candidates: Candidates
    expected: Float[np.ndarray, "m"]


class Pairs(NamedTuple):
    """Pairs in the running (chi-square is zero), their log odds, beliefs, and those taken.

    missed : what it costs each, in log odds, that no third view shows it where one should.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    belief: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    missed: Float[np.ndarray, "m"]


def occluded(
    lines: PictureLines,
    counts: list[int],
    strangers: Strangers,
    matched: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
) -> Pairs:
    """Pairs of views matched beside the tracks through three or more."""
    free = _free_segments(matched.candidates, counts)
    found = [
        _pairs_of(lines, np.array(views), free, strangers)
        for views in combinations(range(len(counts)), 2)
    ]
    candidates = joined_candidates([pairs.candidates for pairs in found])
    expected = np.concatenate([pairs.expected for pairs in found])
    if depth_range_mm is not None:
        keep = in_depth_range(candidates, lines, depth_range_mm)
        candidates, expected = _rows(candidates, keep), expected[keep]
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < FEW:
        habits, joined = usual_habits(candidates.ends_mm, float(np.mean(counts))), USUAL_HABITS
    else:
        habits, joined = most.habits, most.joined
    return _select(candidates, expected, matched, habits, joined)


def _select(
    candidates: Candidates,
    expected: Float[np.ndarray, "m"],
    matched: Tracks,
    habits: Habits,
    joined: JunctionHabits,
) -> Pairs:
    """Beliefs of pairs among lines that are matched already, to a fixed point."""
    ends = _log_ends(candidates, habits) + log_sides(candidates.side_log, habits)
    misfit = np.where(candidates.side_log.any(axis=1), MISFIT_OF_PICTURES, MISFIT)
    evidence = candidates.log_density + ends + expected * LOG_MISSED + misfit
    likely = evidence + habits.log_count + log_place(candidates.ends_mm, habits.volume)
    keep = likely > HOPELESS_LEARNED
    candidates, evidence, expected = _rows(candidates, keep), evidence[keep], expected[keep]
    lines = matched.candidates
    keep = ~claimed(candidates.index, candidates.part, lines.index, lines.part)
    candidates, evidence, expected = _rows(candidates, keep), evidence[keep], expected[keep]
    graph = conflicts(candidates.index, candidates.part)
    meetings = junctions(_joined(lines, candidates))
    known = probability(matched.belief)
    # Without lines in three views to compare with, pairs are what there is.
    share = USUAL_SHARE if len(known) >= FEW else 1.0
    gain = np.zeros(len(evidence))
    belief = gain
    for _ in range(ROUNDS):
        prior = np.log(share) + habits.log_count + log_place(candidates.ends_mm, habits.volume)
        odds = evidence + prior + gain
        belief = beliefs(odds, graph)
        posterior = probability(belief)
        if len(known) >= FEW:
            share = (posterior.sum() + 1) / (known.sum() + 10)
        else:
            habits = habits._replace(
                volume=volume_of(candidates.ends_mm, posterior),
                log_count=float(np.log(max(posterior.sum(), 1.0))),
            )
        if joined.joined >= LEAST_JOINED:
            everyone = np.concatenate([known, posterior])
            density = habits.log_count - habits.volume.log_size + np.log(2)
            gain = support(meetings, everyone, density, joined)[0][len(known) :]
    missed = np.where(expected > 0, expected * LOG_MISSED + np.log(share), 0.0)
    taken = chosen_greedily(belief, graph)
    return Pairs(candidates, odds, tempered(belief, candidates.side_log), taken, missed)


def _rows(candidates: Candidates, keep: Bool[np.ndarray, "m"]) -> Candidates:
    return Candidates(*(field[keep] for field in candidates))


def _joined(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return joined_candidates([matched, pairs])


def _free_segments(matched: Candidates, counts: list[int]) -> list[Int[np.ndarray, "_"]]:
    """Per view, the segments of which less than FREE is matched."""
    free = []
    for view, count in enumerate(counts):
        on = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.part[on, view], axis=1)[:, 0])
        used = np.bincount(matched.index[on, view], length, minlength=count)
        free.append(np.flatnonzero(used < FREE))
    return free


def _log_ends(candidates: Candidates, habits: Habits) -> Float[np.ndarray, "m"]:
    """Evidence of the ends: how those of two views agree follows from how those of three do."""
    agreeing = habits.ends[: len(AGREEING_PX)].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = habits.ends[len(AGREEING_PX) : len(AGREEING_PX) + len(PAIR_PX)]
    on = habits.ends[len(AGREEING_PX) + len(PAIR_PX) : -1]
    agreeing[: len(PAIR_PX)] += (short + on) / 3
    shares = np.append(agreeing, 1 - agreeing.sum())
    return np.log(np.exp(candidates.end_log) @ shares).sum(axis=1)


def _pairs_of(
    lines: PictureLines,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    strangers: Strangers,
) -> _Possible:
    """All pairs of free segments of two views that can be one line."""
    planes = pencil(lines, views[0], views[1])
    low_high = [
        np.stack([np.asarray(s.low), np.asarray(s.high)], axis=1)
        for s in (planes.first, planes.second)
    ]
    i, j = overlapping(low_high[0][free[views[0]]], low_high[1][free[views[1]]])
    segments = np.stack([free[views[0]][i], free[views[1]][j]], axis=1)

    def judged(segments: np.ndarray) -> PairEvidence:
        return _judged(lines, views, planes, segments, strangers)

    found = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    keep = np.flatnonzero(found.possible)
    index = np.full((len(keep), len(lines.size_px)), -1)
    part = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, views], part[:, views] = segments[keep], stacked(found.part, keep)
    candidates = Candidates(
        index,
        part,
        stacked(found.ends_mm, keep),
        np.zeros(len(keep)),
        np.asarray(found.log_density)[keep]
        + polarity_evidence(np.asarray(lines.polarity), index, part),
        stacked(found.end_log, keep),
        stacked(found.outer_mm, keep),
        stacked(found.outer_covariance_mm2, keep),
        np.asarray(found.px_per_mm)[keep],
        side_evidence(np.asarray(lines.sides), index, part),
    )
    return _Possible(candidates, np.asarray(found.expected)[keep])


@jax.jit
def _judged(
    lines: PictureLines,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    strangers: Strangers,
) -> PairEvidence:
    def judge(segments: Int[ArrayLike, "2"]) -> PairEvidence:
        rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
        return pair_evidence(lines, views, planes, rows, segments, strangers)

    return jax.vmap(judge)(jnp.asarray(pairs))
