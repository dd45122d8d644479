"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. The strong
evidence of a pair is that its ends meet those of matched lines. So the pairs of all views are
judged together with the lines matched so far: their posterior log odds are computed as those of
triples are, and iterated to a fixed point.
"""

from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates, concatenated, in_depth_range
from trinoc.match.evidence import (
    AGREEING_PX,
    PAIR_PX,
    MixtureParameters,
    PairEvidence,
    log_place,
    log_sides,
    pair_evidence,
    polarity_evidence,
    prior_parameters,
    probability,
    side_evidence,
    temper,
    volume_of,
)
from trinoc.match.observations import TRIPLES_IN_BLOCK, ClutterModel, SegmentTable, block_of
from trinoc.match.selection import (
    MIN_AT_JUNCTION,
    PRIOR_PARAMETERS,
    PRUNE_LOG_ODDS,
    JunctionParameters,
    Selection,
    Tracks,
    chosen_greedily,
    claimed,
    conflict_graph,
    endpoint_pairs,
    junction_log_odds,
    sum_product,
)
from trinoc.match.two_view import Pencil, pencil, row_of
from trinoc.numerics import ArrayLike, in_blocks, overlapping, stacked

ROUNDS = 6
# With fewer lines than this in three views, their mixture parameters are not used.
MIN_TRACKS_TO_LEARN = 10
# A segment of which less than this is matched may be half of a pair.
MAX_MATCHED_SHARE = 0.5
# Pairs before any is known, as a share of the lines matched in three views.
PRIOR_SHARE = 0.1
# Log odds that a view misses a line within its borders.
LOG_MISSED = float(np.log(0.5))
# Additive correction to the log odds of pairs, chosen on synthetic scenes (seeds 700,000 and above)
# so that the stated posterior matches the observed precision: better on four of five scene types.
LOG_ODDS_OFFSET = 2.25
# The same for segments of images, where clutter is correlated (see TEMPERATURE in `evidence`).
LOG_ODDS_OFFSET_IN_IMAGES = -1.5


class _Possible(NamedTuple):
    candidates: Candidates
    expected: Float[np.ndarray, "m"]


class Pairs(NamedTuple):
    """Candidate pairs (chi-square is zero), their log odds without and with rivals, those taken.

    missed : what it costs each, in log odds, that no third view shows it where one should.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    missed: Float[np.ndarray, "m"]


def occluded_pairs(
    lines: SegmentTable,
    counts: list[int],
    clutter: ClutterModel,
    matched: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
) -> Pairs:
    """Pairs of views matched beside the tracks through three or more."""
    free = _free_segments(matched.candidates, counts)
    found = [
        _pairs_of(lines, np.array(views), free, clutter)
        for views in combinations(range(len(counts)), 2)
    ]
    candidates = concatenated([pairs.candidates for pairs in found])
    expected = np.concatenate([pairs.expected for pairs in found])
    if depth_range_mm is not None:
        keep = in_depth_range(candidates, lines, depth_range_mm)
        candidates, expected = _rows(candidates, keep), expected[keep]
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < MIN_TRACKS_TO_LEARN:
        mixture, junctions = (
            prior_parameters(candidates.ends_mm, float(np.mean(counts))),
            PRIOR_PARAMETERS,
        )
    else:
        mixture, junctions = most.mixture, most.junctions
    return _select(candidates, expected, matched, mixture, junctions)


def _select(
    candidates: Candidates,
    expected: Float[np.ndarray, "m"],
    matched: Tracks,
    mixture: MixtureParameters,
    junctions: JunctionParameters,
) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point."""
    ends = _log_ends(candidates, mixture) + log_sides(candidates.side_log, mixture)
    misfit = np.where(candidates.side_log.any(axis=1), LOG_ODDS_OFFSET_IN_IMAGES, LOG_ODDS_OFFSET)
    evidence = candidates.log_density + ends + expected * LOG_MISSED + misfit
    likely = evidence + mixture.log_count + log_place(candidates.ends_mm, mixture.volume)
    keep = likely > PRUNE_LOG_ODDS
    candidates, evidence, expected = _rows(candidates, keep), evidence[keep], expected[keep]
    lines = matched.candidates
    keep = ~claimed(candidates.index, candidates.interval, lines.index, lines.interval)
    candidates, evidence, expected = _rows(candidates, keep), evidence[keep], expected[keep]
    graph = conflict_graph(candidates.index, candidates.interval)
    meetings = endpoint_pairs(_joined(lines, candidates))
    known = probability(matched.posterior_log_odds)
    # Without lines in three views to compare with, pairs are what there is.
    share = PRIOR_SHARE if len(known) >= MIN_TRACKS_TO_LEARN else 1.0
    gain = np.zeros(len(evidence))
    posterior_log_odds = gain
    for _ in range(ROUNDS):
        prior = np.log(share) + mixture.log_count + log_place(candidates.ends_mm, mixture.volume)
        odds = evidence + prior + gain
        posterior_log_odds = sum_product(odds, graph)
        posterior = probability(posterior_log_odds)
        if len(known) >= MIN_TRACKS_TO_LEARN:
            share = (posterior.sum() + 1) / (known.sum() + 10)
        else:
            mixture = mixture._replace(
                volume=volume_of(candidates.ends_mm, posterior),
                log_count=float(np.log(max(posterior.sum(), 1.0))),
            )
        if junctions.end_at_junction >= MIN_AT_JUNCTION:
            everyone = np.concatenate([known, posterior])
            density = mixture.log_count - mixture.volume.log_size + np.log(2)
            gain = junction_log_odds(meetings, everyone, density, junctions)[0][len(known) :]
    missed = np.where(expected > 0, expected * LOG_MISSED + np.log(share), 0.0)
    taken = chosen_greedily(posterior_log_odds, graph)
    return Pairs(candidates, odds, temper(posterior_log_odds, candidates.side_log), taken, missed)


def _rows(candidates: Candidates, keep: Bool[np.ndarray, "m"]) -> Candidates:
    return Candidates(*(field[keep] for field in candidates))


def _joined(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return concatenated([matched, pairs])


def _free_segments(matched: Candidates, counts: list[int]) -> list[Int[np.ndarray, "_"]]:
    """Per view, the segments of which less than MAX_MATCHED_SHARE is matched."""
    free = []
    for view, count in enumerate(counts):
        on = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.interval[on, view], axis=1)[:, 0])
        used = np.bincount(matched.index[on, view], length, minlength=count)
        free.append(np.flatnonzero(used < MAX_MATCHED_SHARE))
    return free


def _log_ends(candidates: Candidates, mixture: MixtureParameters) -> Float[np.ndarray, "m"]:
    """Evidence of the ends: how those of two views agree follows from how those of three do."""
    agreeing = mixture.ends[: len(AGREEING_PX)].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = mixture.ends[len(AGREEING_PX) : len(AGREEING_PX) + len(PAIR_PX)]
    on = mixture.ends[len(AGREEING_PX) + len(PAIR_PX) : -1]
    agreeing[: len(PAIR_PX)] += (short + on) / 3
    shares = np.append(agreeing, 1 - agreeing.sum())
    return np.log(np.exp(candidates.end_log) @ shares).sum(axis=1)


def _pairs_of(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
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
        return _evidence_of(lines, views, planes, segments, clutter)

    found = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    keep = np.flatnonzero(found.possible)
    index = np.full((len(keep), len(lines.size_px)), -1)
    interval = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, views], interval[:, views] = segments[keep], stacked(found.interval, keep)
    candidates = Candidates(
        index,
        interval,
        stacked(found.ends_mm, keep),
        np.zeros(len(keep)),
        np.asarray(found.log_density)[keep]
        + polarity_evidence(np.asarray(lines.polarity), index, interval),
        stacked(found.end_log, keep),
        stacked(found.union_ends_mm, keep),
        stacked(found.union_covariance_mm2, keep),
        np.asarray(found.px_per_mm)[keep],
        side_evidence(np.asarray(lines.sides), index, interval),
    )
    return _Possible(candidates, np.asarray(found.expected)[keep])


@jax.jit
def _evidence_of(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    clutter: ClutterModel,
) -> PairEvidence:
    def judge(segments: Int[ArrayLike, "2"]) -> PairEvidence:
        rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
        return pair_evidence(lines, views, planes, rows, segments, clutter)

    return jax.vmap(judge)(jnp.asarray(pairs))
