"""Step 3: segments that two views show and the others do not, joined to what is matched.

Two segments that fit are weak evidence, since two views check only their ends. The strong
evidence of a pair is that its ends meet those of matched lines. So the pairs of all views are
judged together with the lines matched so far: their posterior log odds are computed as those of
triples are, and iterated to a fixed point.

possible_pairs -> pairs_beside_lines, or pairs_alone where hardly any line is matched.
"""

from itertools import combinations

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.table import Candidates, in_depth_range
from trinoc.match.evidence.endpoints import end_search_radius_px
from trinoc.match.evidence.mixture import MixtureParameters, prior_parameters, probability
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.match_input import MatchInput
from trinoc.match.observations.table import SegmentTable, segments_per_view
from trinoc.match.occlusion.pairs_alone import pairs_alone
from trinoc.match.occlusion.possible_pairs import (
    Pairs,
    end_shares,
    evidence_beside_lines,
    likely_rows,
    pair_bound,
    possible_pairs,
)
from trinoc.match.occlusion.solids import (
    NO_BODIES,
    Bodies,
    estimate_bodies,
    temper_pairs,
    temper_tracks,
)
from trinoc.match.selection.junction_support import (
    JunctionParameters,
    endpoint_pairs,
    junction_log_odds,
    prior_junctions,
)
from trinoc.match.selection.marginals import Selection, Tracks
from trinoc.match.selection.messages import (
    choose_greedily,
    conflict_graph,
    sum_product,
    with_log_share,
)
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.numerics.joins import broadcast_groups, group_sums
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.tables import concatenate_rows

# What is known of each frame before its pairs are judged.
Rates = tuple[MixtureParameters, JunctionParameters]
# numerical: rounds of marginals, prior and junctions, which converge.
ROUNDS = 6


def match_occluded(
    seen: MatchInput,
    clutter: ClutterModel,
    tracks: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning = DEFAULT,
) -> tuple[Tracks, Pairs]:
    """(tracks through three or more views, tempered; pairs of views matched beside them)."""
    lines, counts = seen.lines, seen.counts
    bodies = estimate_bodies(lines, tracks, selections, tuning)
    tracks = temper_tracks(lines, tracks, bodies, tuning)
    given = lines, counts, clutter, tracks, selections, depth_range_mm, tuning, bodies
    return tracks, occluded_pairs(*given)


def occluded_pairs(
    lines: SegmentTable,
    counts: list[int],
    clutter: ClutterModel,
    matched: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning = DEFAULT,
    bodies: Bodies = NO_BODIES,
) -> Pairs:
    """Pairs of views matched beside the tracks through three or more, in each frame of a stack;
    `bodies` are what these tracks tell of each frame's (see `solids.py`)."""
    free = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    frames = 1 if lines.frame is None else len(lines.matrix_px)
    # Where hardly any line is seen in three views, pairs themselves say how they are.
    label = matched.candidates.frame
    label = np.zeros(len(matched.candidates.index), np.int64) if label is None else label
    alone = np.bincount(label, minlength=frames) < tuning.tracks.min_tracks_to_learn
    learned = _learn_rates(selections, tuning)
    several = lines.frame is not None or alone.any()
    bound, agree_px = None, None
    # In small pictures one more program costs more than it saves.
    if learned is not None and not several and max(counts) > tuning.scouting.above:
        mixture, junctions = learned
        bound = pair_bound(lines, mixture, end_shares(mixture, tuning.ends), tuning)
        # Where ends meet others, a pair may be right whose own ends do not agree.
        if not np.any(junctions.end_at_junction >= tuning.junctions.min_at_junction):
            typical_px = float(np.asarray(clutter.typical_px))
            reach_px = end_search_radius_px(mixture.ends, typical_px, tuning.scouting, tuning.ends)
            agree_px = None if reach_px is None else tuning.occlusion.ends_reach * reach_px

    def keep_likely(found: Candidates) -> Candidates:
        """In range, and, as far as that is known by now, likely at all: it bounds the memory."""
        found = found.take(in_depth_range(found, lines, depth_range_mm))
        if learned is None or several:
            return found
        evidence = evidence_beside_lines(found, learned[0], tuning)
        return found.take(evidence > tuning.selection.prune_log_odds)

    typical, parts = segments_per_view(lines, counts), []
    for views in combinations(range(len(counts)), 2):
        of_views = lines, np.array(views), free, clutter, tuning, bound, agree_px
        for part in possible_pairs(*of_views):
            parts.append(keep_likely(part))
            if sum(len(found.index) for found in parts) > tuning.candidates.most_candidates:
                parts = [_likelier_half(concatenate_rows(parts), typical, tuning)]
    found = concatenate_rows(parts)
    start = _start(found, selections, typical, tuning)
    bodies = Bodies(*(np.broadcast_to(each, np.shape(typical)) for each in bodies))
    typical_px, ends_px = np.asarray(clutter.typical_px), np.asarray(lines.ends_px)
    results = []
    if alone.any():
        beside = _of_frames(found, alone), _of_frames(matched.candidates, alone)
        results.append(pairs_alone(*beside, ends_px, start, typical_px, tuning))
    if not alone.all():
        known = matched.candidates.frame
        tracks = matched if known is None else matched.take(~alone[known])
        own = _of_frames(found, ~alone)
        results.append(pairs_beside_lines(own, tracks, bodies, start, tuning))
    return concatenate_rows(results)


def _likelier_half(
    found: Candidates, typical: Float[np.ndarray, "*f"] | float, tuning: MatchTuning
) -> Candidates:
    """Those of more than usual evidence, by what is usual of lines."""
    usual = prior_parameters(found.ends_mm, typical, tuning, found.frame)
    evidence = evidence_beside_lines(found, usual, tuning)
    return found.take(evidence > np.median(evidence))


def _learn_rates(selections: list[Selection], tuning: MatchTuning) -> Rates | None:
    """What three views taught a single frame, if enough."""
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None or most.taken.sum() < tuning.tracks.min_tracks_to_learn:
        return None
    return most.mixture, most.junctions


def _start(
    found: Candidates,
    selections: list[Selection],
    typical: Float[np.ndarray, "*f"] | float,
    tuning: MatchTuning,
) -> Rates:
    """What three views taught, or what is usual where they show few lines."""
    usual = (
        prior_parameters(found.ends_mm, typical, tuning, found.frame),
        prior_junctions(tuning.junctions, np.shape(typical)),
    )
    most = max(selections, key=lambda selection: selection.taken.sum(), default=None)
    if most is None:
        return usual
    number = group_sums(most.taken.astype(np.float64), most.candidates.frame, np.size(typical))
    enough = number >= tuning.tracks.min_tracks_to_learn

    def choose(learned: ArrayLike | float, usual: ArrayLike | float) -> np.ndarray:
        axes = tuple(range(np.ndim(enough), np.ndim(usual)))
        return np.where(np.expand_dims(enough, axes), learned, usual)

    return jax.tree.map(choose, (most.mixture, most.junctions), usual)


def _of_frames(candidates: Candidates, those: Bool[np.ndarray, "f"]) -> Candidates:
    """Those of some frames of a stack alone."""
    return candidates if candidates.frame is None else candidates.take(those[candidates.frame])


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


def pairs_beside_lines(
    found: Candidates,
    matched: Tracks,
    bodies: Bodies,
    start: Rates,
    tuning: MatchTuning,
) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point;
    `bodies` are of each frame."""
    rules = tuning.occlusion
    log_missed = float(np.log(rules.missed))
    mixture, junctions = start
    evidence = evidence_beside_lines(found, mixture, tuning)
    keep, log_share = likely_rows(found, matched.candidates, evidence, tuning)
    candidates, evidence = found.take(keep), evidence[keep]
    frame = candidates.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    everyone = _join_candidates(matched.candidates, candidates)
    everyones_odds = np.concatenate([matched.posterior_log_odds, evidence])
    meetings = endpoint_pairs(everyone, everyones_odds, tuning.junctions, tuning.evidence)
    known = probability(matched.posterior_log_odds)
    frames = np.size(mixture.log_count)
    lines_known = group_sums(known, matched.candidates.frame, frames)
    prior, weight = rules.prior_share, tuning.evidence.prior_observations
    share = np.full(np.shape(mixture.log_count), prior)
    density = mixture.log_count - mixture.volume.log_size + np.log(2)
    helped = broadcast_groups(junctions.end_at_junction >= tuning.junctions.min_at_junction, frame)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    for _ in range(ROUNDS):
        odds = evidence + broadcast_groups(np.log(share), frame) + gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
        posterior = probability(posterior_log_odds)
        share = (group_sums(posterior, frame, frames) + weight * prior) / (lines_known + weight)
        if np.any(helped):
            gain, _ = junction_log_odds(
                meetings,
                np.concatenate([known, posterior]),
                density,
                junctions,
                tuning.junctions,
                everyone.frame,
            )
            gain = np.where(helped, gain[len(known) :], 0.0)
    of_share = broadcast_groups(np.log(share), frame)
    missed = np.where(
        candidates.expected_views > 0, candidates.expected_views * log_missed + of_share, 0.0
    )
    posterior_log_odds = with_log_share(posterior_log_odds, log_share)
    chosen = choose_greedily(posterior_log_odds, graph)
    bodies = Bodies(*(broadcast_groups(each, frame) for each in bodies))
    of_pair = posterior_log_odds, candidates.side_log, candidates.crossing_sine, bodies
    tempered = temper_pairs(*of_pair, tuning)
    return Pairs(candidates, odds, tempered, chosen, missed)


def _join_candidates(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return concatenate_rows([matched, pairs])
