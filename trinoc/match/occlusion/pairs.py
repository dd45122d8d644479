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
)
from trinoc.match.observations import (
    TRIPLES_IN_BLOCK,
    ClutterModel,
    SegmentTable,
    block_of,
    frames_of,
    of_frame,
    segments_per_view,
)
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
from trinoc.match.two_view import Pencil, pencil, pencil_of, plane_angles, row_of
from trinoc.numerics import (
    ArrayLike,
    concatenate_rows,
    group_sums,
    in_blocks,
    of_group,
    overlapping,
    stacked,
    take_rows,
    taken,
)


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
    """Pairs of views matched beside the tracks through three or more, in each frame of a stack."""
    free = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    found = concatenate_rows(
        [
            _pairs_of(lines, np.array(views), free, clutter, tuning)
            for views in combinations(range(len(counts)), 2)
        ]
    )
    found = take_rows(found, in_depth_range(found.candidates, lines, depth_range_mm))
    frame = frames_of(lines, found.candidates.index)
    frames = 1 if frame is None else len(lines.matrix_px)
    start = _start(found, selections, segments_per_view(lines, counts), frame, tuning)
    # Where hardly any line is seen in three views, pairs themselves say how they are.
    number = _rows_of(matched.candidates, lines, frames)
    alone = number < tuning.occlusion.min_tracks_to_learn
    results = []
    for select, those in ((_select_alone, alone), (_select, ~alone)):
        if those.any():
            results.append(_of_frames(lines, found, matched, start, those, select, clutter, tuning))
    return concatenate_rows(results)


class _Start(NamedTuple):
    """What is known of each frame before its pairs are judged."""

    mixture: MixtureParameters
    junctions: JunctionParameters


class _Beside(NamedTuple):
    """Pairs of some frames, the lines of these that are matched, and the frames of both."""

    found: _Possible
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
    found: _Possible,
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

    def chosen(learned: np.ndarray, usual: np.ndarray) -> np.ndarray:
        axes = tuple(range(np.ndim(enough), np.ndim(usual)))
        return np.where(np.expand_dims(enough, axes), learned, usual)

    return jax.tree.map(chosen, _Start(most.mixture, most.junctions), usual)


def _of_frames(
    lines: SegmentTable,
    found: _Possible,
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
    if frame is not None:
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
    return rows[~claimed(*parts, tuning.selection)]


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
        found: _Possible, evidence: np.ndarray, rates: PairRates, frame: np.ndarray | None
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


def _select(beside: _Beside, start: _Start, _: np.ndarray | float, tuning: MatchTuning) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point."""
    rules, place = tuning.occlusion, partial(log_place, tuning=tuning.evidence)
    log_missed = float(np.log(rules.missed))
    mixture, junctions = start
    found, frame = beside.found, beside.frame
    candidates = found.candidates
    ends = _log_ends(candidates, of_group(end_shares(mixture, tuning.ends), frame))
    ends += log_sides(candidates.side_log, mixture, frame)
    in_images = candidates.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset)
    evidence = candidates.log_density + ends + found.expected * log_missed + offset
    evidence += of_group(mixture.log_count, frame)
    evidence += place(candidates.ends_mm, mixture.volume, frame=frame)
    keep = _likely(beside, evidence, tuning)
    beside, evidence = beside.take(keep), evidence[keep]
    (candidates, expected), frame = beside.found, beside.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    everyone = _joined(beside.matched.candidates, candidates)
    both = None if frame is None else np.concatenate([beside.matched_frame, frame])
    meetings = endpoint_pairs(everyone, tuning.junctions, tuning.evidence, both)
    known = probability(beside.matched.posterior_log_odds)
    frames = np.size(mixture.log_count)
    lines_known = group_sums(known, beside.matched_frame, frames)
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
        plane_angles(lines, int(view), segments)
        for view, segments in zip(views, (planes.first, planes.second), strict=True)
    ]
    i, j = overlapping(low_high[0][free[views[0]]], low_high[1][free[views[1]]])
    segments = np.stack([free[views[0]][i], free[views[1]][j]], axis=1)

    def judged(segments: np.ndarray) -> PairEvidence:
        groups = {"tuning": tuning.candidates, "ends": tuning.ends}
        return _evidence_of(lines, views, planes, segments, clutter, **groups)

    found = in_blocks(judged, block_of(lines, TRIPLES_IN_BLOCK), segments)
    keep = np.flatnonzero(found.possible)
    polarity = np.asarray(lines.polarity)
    index = np.full((len(keep), len(lines.ends_px)), -1)
    interval = np.zeros((len(keep), len(lines.ends_px), 2))
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
        own, among = of_frame(lines, views[0], segments[0]), clutter
        if lines.frame is not None:
            frame = lines.frame[views[0], segments[0]]
            among = clutter._replace(typical_px=clutter.typical_px[frame])
        of_pencil = pencil_of(planes, lines, views[0], segments[0])
        return pair_evidence(own, views, of_pencil, rows, segments, among, tuning, ends)

    return jax.vmap(judge)(jnp.asarray(pairs))
