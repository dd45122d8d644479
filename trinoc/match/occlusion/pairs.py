"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. The strong
evidence of a pair is that its ends meet those of matched lines. So the pairs of all views are
judged together with the lines matched so far: their posterior log odds are computed as those of
triples are, and iterated to a fixed point.
"""

from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates, in_depth_range
from trinoc.match.evidence import (
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
from trinoc.match.occlusion.two_views import PairRates, learned_rates, length_class
from trinoc.match.selection import (
    JunctionParameters,
    Selection,
    Tracks,
    chosen_greedily,
    claimed,
    conflict_graph,
    endpoint_pairs,
    junction_log_odds,
    prior_junctions,
    sum_product,
)
from trinoc.match.tuning import DEFAULT, CandidateTuning, EndTuning, MatchTuning
from trinoc.match.two_view import Pencil, pencil, row_of
from trinoc.numerics import ArrayLike, concatenate_rows, in_blocks, overlapping, stacked, take_rows


class _Possible(NamedTuple):
    """Pairs that can be one line, and in how many other views each should be seen."""

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

    def take(self, rows: np.ndarray) -> "Pairs":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


def occluded_pairs(
    lines: SegmentTable,
    counts: list[int],
    clutter: ClutterModel,
    matched: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning = DEFAULT,
) -> Pairs:
    """Pairs of views matched beside the tracks through three or more."""
    free = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    found = concatenate_rows(
        [
            _pairs_of(lines, np.array(views), free, clutter, tuning)
            for views in combinations(range(len(counts)), 2)
        ]
    )
    found = take_rows(found, in_depth_range(found.candidates, lines, depth_range_mm))
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < tuning.occlusion.min_tracks_to_learn:
        mixture = prior_parameters(found.candidates.ends_mm, float(np.mean(counts)), tuning)
        junctions = prior_junctions(tuning.junctions)
    else:
        mixture, junctions = most.mixture, most.junctions
    if len(matched.posterior_log_odds) < tuning.occlusion.min_tracks_to_learn:
        typical_px = float(clutter.typical_px)
        return _select_alone(found, matched, mixture, junctions, typical_px, tuning)
    return _select(found, matched, mixture, junctions, tuning)


def _select_alone(
    found: _Possible,
    matched: Tracks,
    mixture: MixtureParameters,
    junctions: JunctionParameters,
    typical_px: float,
    tuning: MatchTuning,
) -> Pairs:
    """The same where hardly any line is seen in three views: pairs themselves say how they are."""
    rules, place = tuning.occlusion, partial(log_place, tuning=tuning.evidence)
    in_images = found.candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset_alone)
    evidence = (
        found.candidates.log_density
        + log_sides(found.candidates.side_log, mixture)
        + found.expected * float(np.log(rules.missed))
        + offset
    )
    classes = len(rules.length_classes_px) + 1
    rates = PairRates(end_shares(mixture, tuning.ends), np.zeros(classes), mixture, junctions)

    def odds_of(found: _Possible, evidence: np.ndarray, rates: PairRates) -> np.ndarray:
        c = found.candidates
        ends = np.log(np.exp(c.end_log) @ rates.ends).sum(axis=1)
        lengths = rates.log_by_length[length_class(c, tuning)]
        prior = rates.mixture.log_count + place(c.ends_mm, rates.mixture.volume)
        return evidence + ends + lengths + prior

    keep = odds_of(found, evidence, rates) > tuning.selection.prune_log_odds
    found, evidence = take_rows(found, keep), evidence[keep]
    lines, candidates = matched.candidates, found.candidates
    keep = ~claimed(
        candidates.index, candidates.interval, lines.index, lines.interval, tuning.selection
    )
    found, evidence = take_rows(found, keep), evidence[keep]
    candidates, expected = found
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    meetings = endpoint_pairs(candidates, tuning.junctions, tuning.evidence)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    for _ in range(rules.rounds_alone):
        odds = odds_of(found, evidence, rates) + gain
        posterior_log_odds = sum_product(odds, graph, tuning.selection)
        posterior = probability(posterior_log_odds)
        density = rates.mixture.log_count - rates.mixture.volume.log_size + np.log(2)
        gain, junctions = junction_log_odds(
            meetings, posterior, density, rates.junctions, tuning.junctions
        )
        if junctions.end_at_junction < tuning.junctions.min_at_junction:
            gain = np.zeros(len(evidence))
        rates = learned_rates(candidates, posterior, rates, junctions, typical_px, tuning)
    taken = chosen_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    most = rules.most_alone * probability(tempered)
    tempered = np.log(most) - np.log1p(-most)
    missed = np.where(expected > 0, expected * float(np.log(rules.missed)), 0.0)
    return Pairs(candidates, odds, tempered, taken, missed)


def _select(
    found: _Possible,
    matched: Tracks,
    mixture: MixtureParameters,
    junctions: JunctionParameters,
    tuning: MatchTuning,
) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point."""
    rules, place = tuning.occlusion, partial(log_place, tuning=tuning.evidence)
    log_missed = float(np.log(rules.missed))
    candidates = found.candidates
    ends = _log_ends(candidates, mixture, tuning.ends) + log_sides(candidates.side_log, mixture)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = candidates.log_density + ends + found.expected * log_missed + offset
    likely = evidence + mixture.log_count + place(candidates.ends_mm, mixture.volume)
    keep = likely > tuning.selection.prune_log_odds
    found, evidence = take_rows(found, keep), evidence[keep]
    lines, candidates = matched.candidates, found.candidates
    taken_parts = lines.index, lines.interval
    keep = ~claimed(candidates.index, candidates.interval, *taken_parts, tuning.selection)
    (candidates, expected), evidence = take_rows(found, keep), evidence[keep]
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    meetings = endpoint_pairs(_joined(lines, candidates), tuning.junctions, tuning.evidence)
    known = probability(matched.posterior_log_odds)
    # Without lines in three views to compare with, pairs are what there is.
    share = rules.prior_share if len(known) >= rules.min_tracks_to_learn else 1.0
    gain = np.zeros(len(evidence))
    posterior_log_odds = gain
    for _ in range(rules.rounds):
        prior = np.log(share) + mixture.log_count + place(candidates.ends_mm, mixture.volume)
        odds = evidence + prior + gain
        posterior_log_odds = sum_product(odds, graph, tuning.selection)
        posterior = probability(posterior_log_odds)
        if len(known) >= rules.min_tracks_to_learn:
            share = (posterior.sum() + 1) / (known.sum() + 10)
        else:
            mixture = mixture._replace(
                volume=volume_of(candidates.ends_mm, posterior, tuning.evidence),
                log_count=float(np.log(max(posterior.sum(), 1.0))),
            )
        if junctions.end_at_junction >= tuning.junctions.min_at_junction:
            everyone = np.concatenate([known, posterior])
            density = mixture.log_count - mixture.volume.log_size + np.log(2)
            gain, _ = junction_log_odds(meetings, everyone, density, junctions, tuning.junctions)
            gain = gain[len(known) :]
    missed = np.where(expected > 0, expected * log_missed + np.log(share), 0.0)
    taken = chosen_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    return Pairs(candidates, odds, tempered, taken, missed)


def _joined(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return concatenate_rows([matched, pairs])


def _free_segments(
    matched: Candidates, counts: list[int], most: float
) -> list[Int[np.ndarray, "_"]]:
    """Per view, the segments of which less than a share of `most` is matched."""
    free = []
    for view, count in enumerate(counts):
        on = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.interval[on, view], axis=1)[:, 0])
        used = np.bincount(matched.index[on, view], length, minlength=count)
        free.append(np.flatnonzero(used < most))
    return free


def _log_ends(
    candidates: Candidates, mixture: MixtureParameters, tuning: EndTuning
) -> Float[np.ndarray, "m"]:
    """Evidence of the ends."""
    return np.log(np.exp(candidates.end_log) @ end_shares(mixture, tuning)).sum(axis=1)


def end_shares(mixture: MixtureParameters, tuning: EndTuning) -> Float[np.ndarray, "c"]:
    """How the ends of two views agree follows from how those of three do."""
    all_agree, two_agree = len(tuning.agreeing_px), len(tuning.pair_px)
    agreeing = mixture.ends[:all_agree].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = mixture.ends[all_agree : all_agree + two_agree]
    on = mixture.ends[all_agree + two_agree : -1]
    agreeing[:two_agree] += (short + on) / 3
    return np.append(agreeing, 1 - agreeing.sum())


def _pairs_of(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    free: list[Int[np.ndarray, "_"]],
    clutter: ClutterModel,
    tuning: MatchTuning,
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
        groups = {"tuning": tuning.candidates, "ends": tuning.ends}
        return _evidence_of(lines, views, planes, segments, clutter, **groups)

    found = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    keep = np.flatnonzero(found.possible)
    polarity = np.asarray(lines.polarity)
    index = np.full((len(keep), len(lines.size_px)), -1)
    interval = np.zeros((len(keep), len(lines.size_px), 2))
    index[:, views], interval[:, views] = segments[keep], stacked(found.interval, keep)
    candidates = Candidates(
        index,
        interval,
        stacked(found.ends_mm, keep),
        np.zeros(len(keep)),
        np.asarray(found.log_density)[keep]
        + polarity_evidence(polarity, index, interval, tuning.evidence),
        stacked(found.end_log, keep),
        stacked(found.union_ends_mm, keep),
        stacked(found.union_covariance_mm2, keep),
        np.asarray(found.px_per_mm)[keep],
        side_evidence(np.asarray(lines.sides), index, interval, tuning.sides),
    )
    return _Possible(candidates, np.asarray(found.expected)[keep])


@partial(jax.jit, static_argnames=("tuning", "ends"))
def _evidence_of(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    pairs: Int[ArrayLike, "h 2"],
    clutter: ClutterModel,
    tuning: CandidateTuning,
    ends: EndTuning,
) -> PairEvidence:
    def judge(segments: Int[ArrayLike, "2"]) -> PairEvidence:
        rows = row_of(planes.first, segments[0]), row_of(planes.second, segments[1])
        return pair_evidence(lines, views, planes, rows, segments, clutter, tuning, ends)

    return jax.vmap(judge)(jnp.asarray(pairs))
