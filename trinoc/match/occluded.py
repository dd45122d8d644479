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
from trinoc.match.candidates import Candidates, row_of, stacked
from trinoc.match.ends import AGREEING_PX, PAIR_PX
from trinoc.match.evidence import Habits, log_place, probability
from trinoc.match.exclusivity import beliefs, chosen_greedily, conflicts
from trinoc.match.intervals import overlapping
from trinoc.match.likelihood import Strangers
from trinoc.match.neighbours import junctions, support
from trinoc.match.padding import bucket, padded
from trinoc.match.pair_likelihood import PairEvidence, pair_evidence
from trinoc.match.pencil import Pencil, pencil
from trinoc.match.picture_lines import PictureLines
from trinoc.match.selection import HOPELESS_LEARNED, LEAST_JOINED, Selection

ROUNDS = 6
# A segment of which less than this is matched may be half of a pair.
FREE = 0.5
# Pairs before any is known, as a share of the lines matched in three views.
USUAL_SHARE = 0.1
# Log odds that a view misses a line within its borders, where nothing hides it.
LOG_MISSED = float(np.log(0.3))


class Pairs(NamedTuple):
    """Pairs in the running (chi-square is zero), their log odds, beliefs, and those taken."""

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    belief: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]


def occluded(
    lines: PictureLines, counts: list[int], strangers: Strangers, chosen: Selection
) -> Pairs:
    """Pairs of views matched beside the triples that were chosen."""
    matched = Candidates(*(field[chosen.taken] for field in chosen.candidates))
    free = _free_segments(matched, counts)
    ends = _pair_shares(chosen.habits)
    found = []
    for a, b in combinations(range(len(counts)), 2):
        found.append(_pairs_of(lines, np.array([a, b]), free, strangers, ends, chosen.habits))
    candidates = Candidates(*(np.concatenate(column) for column in zip(*found, strict=True)))
    clear = ~_claimed(candidates, matched)
    candidates = Candidates(*(field[clear] for field in candidates))
    alone = candidates.log_density
    graph = conflicts(candidates.index, candidates.part)
    together = _joined(matched, candidates)
    meetings = junctions(together)
    known = probability(chosen.belief[chosen.taken])
    joined = chosen.joined
    log_ends_density = chosen.habits.log_count - chosen.habits.volume.log_size + np.log(2)
    share = USUAL_SHARE
    gain = np.zeros(len(alone))
    for _ in range(ROUNDS):
        belief = beliefs(alone + np.log(share) + gain, graph)
        posterior = probability(belief)
        share = (posterior.sum() + 1) / (known.sum() + 10)
        if joined.joined >= LEAST_JOINED:
            everyone = np.concatenate([known, posterior])
            gain = support(meetings, everyone, log_ends_density, joined)[0][len(known) :]
    odds = alone + np.log(share) + gain
    belief = beliefs(odds, graph)
    return Pairs(candidates, odds, belief, chosen_greedily(belief, graph))


def _joined(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return Candidates(*(np.concatenate(columns) for columns in zip(matched, pairs, strict=True)))


def _free_segments(matched: Candidates, counts: list[int]) -> list[Int[np.ndarray, "_"]]:
    """Per view, the segments of which less than FREE is matched."""
    free = []
    for view, count in enumerate(counts):
        on = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.part[on, view], axis=1)[:, 0])
        used = np.bincount(matched.index[on, view], length, minlength=count)
        free.append(np.flatnonzero(used < FREE))
    return free


def _claimed(candidates: Candidates, matched: Candidates) -> Bool[np.ndarray, "m"]:
    """Whether a pair needs a part of a segment that a matched line has."""
    count = len(matched.index)
    index = np.concatenate([matched.index, candidates.index])
    graph = conflicts(index, np.concatenate([matched.part, candidates.part]))
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    claimed = np.zeros(len(index), dtype=bool)
    claimed[owner[rival < count]] = True
    return claimed[count:]


def _pair_shares(habits: Habits) -> Float[np.ndarray, "c"]:
    """How ends of two views agree, from how those of three do."""
    agreeing = habits.ends[: len(AGREEING_PX)].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = habits.ends[len(AGREEING_PX) : len(AGREEING_PX) + len(PAIR_PX)]
    on = habits.ends[len(AGREEING_PX) + len(PAIR_PX) : -1]
    agreeing[: len(PAIR_PX)] += (short + on) / 3
    return np.append(agreeing, 1 - agreeing.sum())


def _pairs_of(
    lines: PictureLines,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    strangers: Strangers,
    shares: Float[np.ndarray, "c"],
    habits: Habits,
) -> Candidates:
    planes = pencil(lines, views[0], views[1])
    angles = [
        np.stack([np.asarray(s.low), np.asarray(s.high)], axis=1)
        for s in (planes.first, planes.second)
    ]
    i, j = overlapping(angles[0][free[views[0]]], angles[1][free[views[1]]])
    segments = np.stack([free[views[0]][i], free[views[1]][j]], axis=1)
    size = bucket(len(segments))
    found = _judged(lines, views, planes, padded(segments, size), strangers)
    ends = stacked(found.end_log, slice(0, len(segments)))
    log_ends = np.log(np.exp(ends) @ shares).sum(axis=1)
    expected = np.asarray(found.expected)[: len(segments)]
    ends_mm = stacked(found.ends_mm, slice(0, len(segments)))
    prior = habits.log_count + log_place(ends_mm, habits.volume) + expected * LOG_MISSED
    log_density = np.asarray(found.log_density)[: len(segments)] + log_ends + prior
    possible = np.asarray(found.possible)[: len(segments)]
    keep = np.flatnonzero(possible & (log_density > HOPELESS_LEARNED))
    index = np.full((len(keep), len(lines.size_px)), -1)
    part = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, views], part[:, views] = segments[keep], stacked(found.part, keep)
    return Candidates(
        index,
        part,
        ends_mm[keep],
        np.zeros(len(keep)),
        log_density[keep],
        np.zeros((len(keep), 2, 0)),
        stacked(found.outer_mm, keep),
        stacked(found.outer_covariance_mm2, keep),
        np.asarray(found.px_per_mm)[keep],
    )


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
