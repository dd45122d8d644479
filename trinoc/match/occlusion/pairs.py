"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. The strong
evidence of a pair is that its ends meet those of matched lines. So the pairs of all views are
judged together with the lines matched so far: their posterior log odds are computed as those of
triples are, and iterated to a fixed point.
"""

from collections.abc import Callable
from functools import partial
from itertools import combinations
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates import Candidates, in_depth_range
from trinoc.match.evidence import (
    MixtureParameters,
    log_place,
    log_sides,
    prior_parameters,
    probability,
    temper,
)
from trinoc.match.observations import (
    ClutterModel,
    SegmentTable,
    frames_of,
    segments_per_view,
)
from trinoc.match.occlusion.possible_pairs import PossiblePairs, possible_pairs
from trinoc.match.occlusion.two_views import PairRates, learned_rates, length_class
from trinoc.match.selection import (
    JunctionParameters,
    Selection,
    Tracks,
    affordable,
    chosen_greedily,
    claimed,
    conflict_graph,
    endpoint_pairs,
    junction_log_odds,
    prior_junctions,
    sum_product,
)
from trinoc.match.tuning import DEFAULT, EndTuning, MatchTuning
from trinoc.numerics import (
    ArrayLike,
    concatenate_rows,
    group_sums,
    of_group,
    take_rows,
    taken,
)


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
    """Pairs of views matched beside the tracks through three or more, in each frame of a stack."""
    free = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    frames = 1 if lines.frame is None else len(lines.matrix_px)
    # Where hardly any line is seen in three views, pairs themselves say how they are.
    number = _rows_of(matched.candidates, lines, frames)
    alone = number < tuning.occlusion.min_tracks_to_learn
    learned = _learned_from(selections, tuning)

    def kept(found: PossiblePairs) -> PossiblePairs:
        """In range, and, as far as that is known by now, likely at all: it bounds the memory."""
        found = take_rows(found, in_depth_range(found.candidates, lines, depth_range_mm))
        if learned is None or lines.frame is not None or alone.any():
            return found
        evidence = _evidence(found, learned.mixture, None, tuning)
        return take_rows(found, evidence > tuning.selection.prune_log_odds)

    found = concatenate_rows(
        [
            kept(part)
            for views in combinations(range(len(counts)), 2)
            for part in possible_pairs(lines, np.array(views), free, clutter, tuning)
        ]
    )
    frame = frames_of(lines, found.candidates.index)
    start = _start(found, selections, segments_per_view(lines, counts), frame, tuning)
    results = []
    for select, those in ((_select_alone, alone), (_select, ~alone)):
        if those.any():
            results.append(_of_frames(lines, found, matched, start, those, select, clutter, tuning))
    return concatenate_rows(results)


class _Start(NamedTuple):
    """What is known of each frame before its pairs are judged."""

    mixture: MixtureParameters
    junctions: JunctionParameters


def _learned_from(selections: list[Selection], tuning: MatchTuning) -> _Start | None:
    """What three views taught a single frame, if enough."""
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < tuning.occlusion.min_tracks_to_learn:
        return None
    return _Start(most.mixture, most.junctions)


class _Beside(NamedTuple):
    """Pairs of some frames, the lines of these that are matched, and the frames of both."""

    found: PossiblePairs
    matched: Tracks
    frame: Int[np.ndarray, "m"] | None
    matched_frame: Int[np.ndarray, "t"] | None

    def take(self, rows: np.ndarray) -> "_Beside":
        """With some of the pairs."""
        return self._replace(found=take_rows(self.found, rows), frame=taken(self.frame, rows))


def _rows_of(candidates: Candidates, lines: SegmentTable, frames: int) -> Int[np.ndarray, "f"]:
    label = frames_of(lines, candidates.index)
    label = np.zeros(len(candidates.index), np.int64) if label is None else label
    return np.bincount(label, minlength=frames)


def _start(
    found: PossiblePairs,
    selections: list[Selection],
    typical: Float[np.ndarray, "*f"] | float,
    frame: Int[np.ndarray, "m"] | None,
    tuning: MatchTuning,
) -> _Start:
    """What three views taught, or what is usual where they show few lines."""
    ends_mm = found.candidates.ends_mm
    usual = _Start(
        prior_parameters(ends_mm, typical, tuning, frame),
        prior_junctions(tuning.junctions, np.shape(typical)),
    )
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None:
        return usual
    number = group_sums(most.taken.astype(np.float64), most.frame, np.size(typical))
    enough = number >= tuning.occlusion.min_tracks_to_learn

    def chosen(learned: ArrayLike | float, usual: ArrayLike | float) -> np.ndarray:
        axes = tuple(range(np.ndim(enough), np.ndim(usual)))
        return np.where(np.expand_dims(enough, axes), learned, usual)

    return jax.tree.map(chosen, _Start(most.mixture, most.junctions), usual)


def _of_frames(
    lines: SegmentTable,
    found: PossiblePairs,
    matched: Tracks,
    start: _Start,
    those: Bool[np.ndarray, "f"],
    select: Callable[[_Beside, _Start, np.ndarray | float, MatchTuning], Pairs],
    clutter: ClutterModel,
    tuning: MatchTuning,
) -> Pairs:
    """The pairs of those frames alone."""
    frame = frames_of(lines, found.candidates.index)
    matched_frame = frames_of(lines, matched.candidates.index)
    if frame is not None and matched_frame is not None:
        rows, tracks = np.flatnonzero(those[frame]), np.flatnonzero(those[matched_frame])
        found, frame = take_rows(found, rows), frame[rows]
        matched, matched_frame = matched.take(tracks), matched_frame[tracks]
    beside = _Beside(found, matched, frame, matched_frame)
    return select(beside, start, np.asarray(clutter.typical_px), tuning)


def _likely(
    beside: _Beside, odds: Float[np.ndarray, "m"], tuning: MatchTuning
) -> Int[np.ndarray, "k"]:
    """Rows of pairs that are likely at all, and need no part of a segment that is matched."""
    rows = np.flatnonzero(odds > tuning.selection.prune_log_odds)
    candidates, lines = beside.found.candidates.take(rows), beside.matched.candidates
    parts = candidates.index, candidates.interval, lines.index, lines.interval
    rows = rows[~claimed(*parts, tuning.selection)]
    index = beside.found.candidates.index[rows]
    return rows[affordable(odds[rows], index, tuning.selection)]


def _select_alone(
    beside: _Beside, start: _Start, typical_px: np.ndarray | float, tuning: MatchTuning
) -> Pairs:
    """The same where hardly any line is seen in three views: pairs themselves say how they are."""
    rules, place = tuning.occlusion, partial(log_place, tuning=tuning.evidence)
    found, frame = beside.found, beside.frame
    mixture, junctions = start
    in_images = found.candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset_alone)
    evidence = (
        found.candidates.log_density
        + log_sides(found.candidates.side_log, mixture, frame)
        + found.expected * float(np.log(rules.missed))
        + offset
    )
    frames, classes = np.shape(mixture.log_count), len(rules.length_classes_px) + 1
    ends = end_shares(mixture, tuning.ends)
    rates = PairRates(ends, np.zeros((*frames, classes)), mixture, junctions)

    def odds_of(
        found: PossiblePairs, evidence: np.ndarray, rates: PairRates, frame: np.ndarray | None
    ) -> np.ndarray:
        c = found.candidates
        ends = _log_ends(c, of_group(rates.ends, frame))
        classes = length_class(c, tuning)
        every = of_group(rates.log_by_length, frame)
        lengths = every[classes] if frame is None else every[np.arange(len(classes)), classes]
        prior = of_group(rates.mixture.log_count, frame)
        return (
            evidence + ends + lengths + prior + place(c.ends_mm, rates.mixture.volume, frame=frame)
        )

    keep = _likely(beside, odds_of(found, evidence, rates, frame), tuning)
    beside, evidence = beside.take(keep), evidence[keep]
    found, frame = beside.found, beside.frame
    candidates, expected = found
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    meetings = endpoint_pairs(candidates, tuning.junctions, tuning.evidence, frame)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    for _ in range(rules.rounds_alone):
        odds = odds_of(found, evidence, rates, frame) + gain
        posterior_log_odds = sum_product(odds, graph, tuning.selection, frame)
        posterior = probability(posterior_log_odds)
        density = rates.mixture.log_count - rates.mixture.volume.log_size + np.log(2)
        gain, junctions = junction_log_odds(
            meetings, posterior, density, rates.junctions, tuning.junctions, frame
        )
        helped = junctions.end_at_junction >= tuning.junctions.min_at_junction
        gain = np.where(of_group(helped, frame), gain, 0.0)
        rates = learned_rates(candidates, posterior, rates, junctions, typical_px, tuning, frame)
    chosen = chosen_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    most = rules.most_alone * probability(tempered)
    tempered = np.log(most) - np.log1p(-most)
    missed = np.where(expected > 0, expected * float(np.log(rules.missed)), 0.0)
    return Pairs(candidates, odds, tempered, chosen, missed)


def _select(
    beside: _Beside, start: _Start, typical_px: np.ndarray | float, tuning: MatchTuning
) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point."""
    rules = tuning.occlusion
    log_missed = float(np.log(rules.missed))
    mixture, junctions = start
    evidence = _evidence(beside.found, mixture, beside.frame, tuning)
    keep = _likely(beside, evidence, tuning)
    beside, evidence = beside.take(keep), evidence[keep]
    (candidates, expected), frame = beside.found, beside.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    everyone = _joined(beside.matched.candidates, candidates)
    known_frame, both = beside.matched_frame, None
    if frame is not None and known_frame is not None:
        both = np.concatenate([known_frame, frame])
    meetings = endpoint_pairs(everyone, tuning.junctions, tuning.evidence, both)
    known = probability(beside.matched.posterior_log_odds)
    frames = np.size(mixture.log_count)
    lines_known = group_sums(known, known_frame, frames)
    share = np.full(np.shape(mixture.log_count), rules.prior_share)
    density = mixture.log_count - mixture.volume.log_size + np.log(2)
    helped = of_group(junctions.end_at_junction >= tuning.junctions.min_at_junction, frame)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    for _ in range(rules.rounds):
        odds = evidence + of_group(np.log(share), frame) + gain
        posterior_log_odds = sum_product(odds, graph, tuning.selection, frame)
        posterior = probability(posterior_log_odds)
        share = (group_sums(posterior, frame, frames) + 1) / (lines_known + 10)
        if np.any(helped):
            gain, _ = junction_log_odds(
                meetings,
                np.concatenate([known, posterior]),
                density,
                junctions,
                tuning.junctions,
                both,
            )
            gain = np.where(helped, gain[len(known) :], 0.0)
    of_share = of_group(np.log(share), frame)
    missed = np.where(expected > 0, expected * log_missed + of_share, 0.0)
    chosen = chosen_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    return Pairs(candidates, odds, tempered, chosen, missed)


def _evidence(
    found: PossiblePairs,
    mixture: MixtureParameters,
    frame: Int[np.ndarray, "m"] | None,
    tuning: MatchTuning,
) -> Float[np.ndarray, "m"]:
    """Log odds of pairs among matched lines, but for how seldom pairs are, and for junctions."""
    rules, candidates = tuning.occlusion, found.candidates
    ends = _log_ends(candidates, of_group(end_shares(mixture, tuning.ends), frame))
    ends += log_sides(candidates.side_log, mixture, frame)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = candidates.log_density + ends + found.expected * float(np.log(rules.missed))
    place = log_place(candidates.ends_mm, mixture.volume, tuning.evidence, frame)
    return evidence + offset + of_group(mixture.log_count, frame) + place


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


def _log_ends(candidates: Candidates, shares: Float[np.ndarray, "*m c"]) -> Float[np.ndarray, "m"]:
    """Evidence of the ends, by the shares of their components."""
    return np.log((np.exp(candidates.end_log) @ shares[..., None])[..., 0]).sum(axis=1)


def end_shares(mixture: MixtureParameters, tuning: EndTuning) -> Float[np.ndarray, "*f c"]:
    """How the ends of two views agree follows from how those of three do."""
    all_agree, two_agree = len(tuning.agreeing_px), len(tuning.pair_px)
    agreeing = mixture.ends[..., :all_agree].copy()
    # Of two views that agree against the third, a given pair is one in three.
    short = mixture.ends[..., all_agree : all_agree + two_agree]
    on = mixture.ends[..., all_agree + two_agree : -1]
    agreeing[..., :two_agree] += (short + on) / 3
    return np.concatenate([agreeing, 1 - agreeing.sum(axis=-1, keepdims=True)], axis=-1)
