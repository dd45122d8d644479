"""Step 3 of the paper: match segments that two views show and the others do not, joined to matched
lines.

Two segments that fit are weak evidence, because two views test only their ends. Strong evidence
is that the ends of a pair meet those of matched lines. So the pairs of all views are evaluated
together with the matched lines. Their posterior log odds are computed as for triples and
iterated to a fixed point. `pairs_beside_lines` does this. Where hardly any line is matched in
three views, `pairs_alone` replaces it.
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
from trinoc.match.occlusion.pairs_alone import match_pairs_alone
from trinoc.match.occlusion.possible_pairs import (
    Pairs,
    end_shares,
    likely_pair_rows,
    log_odds_among_lines,
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

# Parameters of each frame before its pairs are evaluated.
Rates = tuple[MixtureParameters, JunctionParameters]
# numerical: rounds of marginals, prior and junctions until convergence.
ROUNDS = 6


def match_occluded(
    inputs: MatchInput,
    clutter: ClutterModel,
    tracks: Tracks,
    selections: list[Selection],
    depth_range_mm: tuple[float, float] | None,
    tuning: MatchTuning = DEFAULT,
) -> tuple[Tracks, Pairs]:
    """Match the segments that only two views show, and reduce the log odds of the tracks.

    Returns (tracks, pairs). The reduction (`temper_tracks`) is for solid bodies, whose edges have
    correlated evidence.
    """
    lines, counts = inputs.lines, inputs.counts
    bodies = estimate_bodies(lines, tracks, selections, tuning)
    tracks = temper_tracks(lines, tracks, bodies, tuning)
    pairs = occluded_pairs(
        lines, counts, clutter, tracks, selections, depth_range_mm, tuning, bodies
    )
    return tracks, pairs


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
    """Match pairs of segments that no track uses, for all pairs of views and all frames of a stack.

    `matched` are the tracks in three or more views. `bodies` describes how solid the bodies of each
    frame are, see `solids.py`.
    """
    free_segments = _free_segments(matched.candidates, counts, tuning.occlusion.max_matched_share)
    frames = 1 if lines.frame is None else len(lines.matrix_px)
    # In frames with hardly any line in three views, the rates are estimated from the pairs.
    label = matched.candidates.frame
    label = np.zeros(len(matched.candidates.index), np.int64) if label is None else label
    is_alone = np.bincount(label, minlength=frames) < tuning.tracks.min_tracks_to_learn
    rates = _learn_rates(selections, tuning)
    is_stack_or_alone = lines.frame is not None or is_alone.any()
    bound, agree_px = None, None
    # For few segments, compiling one more program takes longer than the bound saves.
    if rates is not None and not is_stack_or_alone and max(counts) > tuning.scouting.min_segments:
        mixture, junctions = rates
        bound = pair_bound(lines, mixture, end_shares(mixture, tuning.ends), tuning)
        # In a scene with junctions, a pair may be right although its ends do not agree.
        if not np.any(junctions.end_at_junction >= tuning.junctions.min_junction_share):
            typical_px = float(np.asarray(clutter.typical_px))
            search_px = end_search_radius_px(mixture.ends, typical_px, tuning.scouting, tuning.ends)
            agree_px = None if search_px is None else tuning.occlusion.ends_factor * search_px

    def keep_likely(pairs: Candidates) -> Candidates:
        """Return the pairs that are in the depth range and likely. This limits the memory."""
        pairs = pairs.take(in_depth_range(pairs, lines, depth_range_mm))
        if rates is None or is_stack_or_alone:
            return pairs
        evidence = log_odds_among_lines(pairs, rates[0], tuning)
        return pairs.take(evidence > tuning.selection.prune_log_odds)

    mean_counts, parts = segments_per_view(lines, counts), []
    for views in combinations(range(len(counts)), 2):
        arguments = lines, np.array(views), free_segments, clutter, tuning, bound, agree_px
        for part in possible_pairs(*arguments):
            parts.append(keep_likely(part))
            if sum(len(pairs.index) for pairs in parts) > tuning.candidates.max_candidates:
                parts = [_likelier_half(concatenate_rows(parts), mean_counts, tuning)]
    pairs = concatenate_rows(parts)
    initial_rates = _initial_rates(pairs, selections, mean_counts, tuning)
    bodies = Bodies(*(np.broadcast_to(field, np.shape(mean_counts)) for field in bodies))
    typical_px, ends_px = np.asarray(clutter.typical_px), np.asarray(lines.ends_px)
    results = []
    if is_alone.any():
        inputs_alone = _take_frames(pairs, is_alone), _take_frames(matched.candidates, is_alone)
        results.append(match_pairs_alone(*inputs_alone, ends_px, initial_rates, typical_px, tuning))
    if not is_alone.all():
        track_frame = matched.candidates.frame
        tracks = matched if track_frame is None else matched.take(~is_alone[track_frame])
        pairs_among_lines = _take_frames(pairs, ~is_alone)
        results.append(pairs_beside_lines(pairs_among_lines, tracks, bodies, initial_rates, tuning))
    return concatenate_rows(results)


def _likelier_half(
    pairs: Candidates, mean_counts: Float[np.ndarray, "*f"] | float, tuning: MatchTuning
) -> Candidates:
    """Return the pairs whose log odds are above the median.

    The log odds use the prior mixture parameters. `mean_counts` is the number of segments per view,
    for each frame.
    """
    mixture = prior_parameters(pairs.ends_mm, mean_counts, tuning, pairs.frame)
    evidence = log_odds_among_lines(pairs, mixture, tuning)
    return pairs.take(evidence > np.median(evidence))


def _learn_rates(selections: list[Selection], tuning: MatchTuning) -> Rates | None:
    """Return the mixture and junction parameters estimated from triples, for a single frame.

    The result is None if there are too few triples.
    """
    largest = max(selections, key=lambda selection: selection.is_accepted.sum(), default=None)
    if largest is None or largest.is_accepted.sum() < tuning.tracks.min_tracks_to_learn:
        return None
    return largest.mixture, largest.junctions


def _initial_rates(
    pairs: Candidates,
    selections: list[Selection],
    mean_counts: Float[np.ndarray, "*f"] | float,
    tuning: MatchTuning,
) -> Rates:
    """Return the initial mixture and junction parameters for the pairs of each frame.

    The parameters were estimated from triples. Frames with few triples have the parameters of the
    prior.
    """
    prior_rates = (
        prior_parameters(pairs.ends_mm, mean_counts, tuning, pairs.frame),
        prior_junctions(tuning.junctions, np.shape(mean_counts)),
    )
    largest = max(selections, key=lambda selection: selection.is_accepted.sum(), default=None)
    if largest is None:
        return prior_rates
    accepted_count = group_sums(
        largest.is_accepted.astype(np.float64), largest.candidates.frame, np.size(mean_counts)
    )
    has_enough = accepted_count >= tuning.tracks.min_tracks_to_learn

    def choose(learned_value: ArrayLike | float, prior_rates: ArrayLike | float) -> np.ndarray:
        axes = tuple(range(np.ndim(has_enough), np.ndim(prior_rates)))
        return np.where(np.expand_dims(has_enough, axes), learned_value, prior_rates)

    return jax.tree.map(choose, (largest.mixture, largest.junctions), prior_rates)


def _take_frames(candidates: Candidates, is_selected: Bool[np.ndarray, "f"]) -> Candidates:
    """Return the candidates of the selected frames of a stack."""
    return (
        candidates if candidates.frame is None else candidates.take(is_selected[candidates.frame])
    )


def _free_segments(
    matched: Candidates, counts: list[int], max_share: float
) -> list[Int[np.ndarray, "_"]]:
    """Return the free segments of each view, those of which less than `max_share` is matched.

    The matched share of a segment is the part of its length that the tracks `matched` use.
    """
    free_segments = []
    for view, count in enumerate(counts):
        has_segment = matched.index[:, view] >= 0
        length = np.abs(np.diff(matched.interval[has_segment, view], axis=1)[:, 0])
        matched_share = np.bincount(matched.index[has_segment, view], length, minlength=count)
        free_segments.append(np.flatnonzero(matched_share < max_share))
    return free_segments


def pairs_beside_lines(
    pairs: Candidates,
    matched: Tracks,
    bodies: Bodies,
    initial_rates: Rates,
    tuning: MatchTuning,
) -> Pairs:
    """Compute the posterior log odds of pairs, with junctions between pairs and matched lines.

    Three steps are iterated until they are stable: posteriors given competing pairs, the prior, and
    the evidence of junctions.
    """
    rules = tuning.occlusion
    log_missed = float(np.log(rules.miss_probability))
    mixture, junctions = initial_rates
    evidence = log_odds_among_lines(pairs, mixture, tuning)
    selected_rows, log_share = likely_pair_rows(pairs, matched.candidates, evidence, tuning)
    candidates, evidence = pairs.take(selected_rows), evidence[selected_rows]
    frame = candidates.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    all_candidates = _join_candidates(matched.candidates, candidates)
    all_log_odds = np.concatenate([matched.posterior_log_odds, evidence])
    end_pairs = endpoint_pairs(all_candidates, all_log_odds, tuning.junctions, tuning.evidence)
    line_posterior = probability(matched.posterior_log_odds)
    frames = np.size(mixture.log_count)
    line_counts = group_sums(line_posterior, matched.candidates.frame, frames)
    prior, weight = rules.prior_share, tuning.evidence.prior_observations
    pair_share = np.full(np.shape(mixture.log_count), prior)
    density = mixture.log_count - mixture.volume.log_size + np.log(2)
    has_junctions = broadcast_groups(
        junctions.end_at_junction >= tuning.junctions.min_junction_share, frame
    )
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    for _ in range(ROUNDS):
        odds = evidence + broadcast_groups(np.log(pair_share), frame) + gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
        posterior = probability(posterior_log_odds)
        pair_share = (group_sums(posterior, frame, frames) + weight * prior) / (
            line_counts + weight
        )
        if np.any(has_junctions):
            gain, _ = junction_log_odds(
                end_pairs,
                np.concatenate([line_posterior, posterior]),
                density,
                junctions,
                tuning.junctions,
                all_candidates.frame,
            )
            gain = np.where(has_junctions, gain[len(line_posterior) :], 0.0)
    log_prior_share = broadcast_groups(np.log(pair_share), frame)
    miss_log_odds = np.where(
        candidates.expected_views > 0, candidates.expected_views * log_missed + log_prior_share, 0.0
    )
    posterior_log_odds = with_log_share(posterior_log_odds, log_share)
    is_accepted = choose_greedily(posterior_log_odds, graph)
    bodies = Bodies(*(broadcast_groups(field, frame) for field in bodies))
    pair_arguments = posterior_log_odds, candidates.side_log, candidates.crossing_sine, bodies
    tempered = temper_pairs(*pair_arguments, tuning)
    return Pairs(candidates, odds, tempered, is_accepted, miss_log_odds)


def _join_candidates(matched: Candidates, pairs: Candidates) -> Candidates:
    # The end evidence is already included, and its shapes differ.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return concatenate_rows([matched, pairs])
