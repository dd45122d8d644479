"""Step 3 where hardly any line is matched in three views: all rates are estimated from the pairs.

No third view tests a pair, so its odds are only as good as the rates that they use. EM estimates
these from all candidates. They are the number of lines of each length, the agreement of ends, the
frequency of junctions, and the density of lines in space. Broken pieces are short and seldom have a
partner. In a scene without junctions, ends meet by chance.

A wrong pair lies anywhere along its viewing rays, while right pairs lie near other lines. A box
of their spread is enough for triples, but too coarse here, because the wrong pairs enlarge it.
The density is therefore a product of profiles along the principal axes.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.candidates.table import Candidates
from trinoc.match.evidence.mixture import (
    MixtureParameters,
    Volume,
    fit_volume,
    log_position_density,
    log_sides,
    probability,
    temper,
)
from trinoc.match.occlusion.companions import companion_log_odds, find_companions
from trinoc.match.occlusion.possible_pairs import (
    Pairs,
    end_shares,
    likely_pair_rows,
    log_ends,
)
from trinoc.match.occlusion.solids import Bodies, see_through_share, temper_pairs
from trinoc.match.selection.junction_support import (
    JunctionParameters,
    endpoint_pairs,
    junction_log_odds,
)
from trinoc.match.selection.messages import (
    choose_greedily,
    conflict_graph,
    sum_product,
    with_log_share,
)
from trinoc.match.tuning.every_group import MatchTuning
from trinoc.match.tuning.occlusion import OcclusionTuning
from trinoc.numerics.joins import broadcast_groups, group_sums, take_groups

# numerical: weight of a line in its bin of a profile, and in each of the two neighbouring bins.
_CENTRE_WEIGHT, _NEIGHBOUR_WEIGHT = 0.5, 0.25
# numerical: number of bins of a profile.
BINS = 32
# numerical: rounds of EM until convergence.
ROUNDS = 10


def log_position_density_among(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    volume: Volume,
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
) -> Float[np.ndarray, "m"]:
    """Log density of lines at the position of each candidate, given all other candidates, (m,).

    The density is per mm^3 and steradian. Every candidate has its posterior as weight. A candidate
    does not count for its own density, so an isolated candidate gets a low density.

    Notes
    -----
    The density is a product of three one-dimensional densities (profiles), one along each axis of
    `volume`. The value of a candidate is the geometric mean of those at its two ends.
    """
    # Principal axes, each divided by the standard deviation along it.
    inverse_variance, eigenvectors = np.linalg.eigh(volume.precision)
    axes = np.sqrt(inverse_variance)[..., None] * eigenvectors.mT
    bins = _profile_bins(
        ends_mm,
        broadcast_groups(volume.centre_mm, frame),
        broadcast_groups(axes, frame),
        tuning.occlusion,
    )
    width, prior_share = _prior_profile(tuning.occlusion)
    frames, prior = np.size(volume.log_size), tuning.evidence.prior_observations
    other_count = broadcast_groups(group_sums(posterior, frame, frames), frame) - posterior
    # Jacobian from coordinates of unit variance to mm^3.
    log_density = broadcast_groups(0.5 * np.log(inverse_variance).sum(axis=-1), frame) - np.log(
        2 * np.pi
    )
    for axis in range(3):
        first, second = bins[:, :, axis].T
        shared_weight = np.where(
            first == second,
            _CENTRE_WEIGHT,
            np.where(abs(first - second) == 1, _NEIGHBOUR_WEIGHT, 0.0),
        )
        self_weight = posterior / 2 * (_CENTRE_WEIGHT + shared_weight)
        profile = _profile(first, second, posterior, BINS, frame, frames)
        for bin_ in (first, second):
            count = profile[bin_] if frame is None else profile[frame, bin_]
            share = (np.maximum(count - self_weight, 0.0) + prior * prior_share[bin_]) / (
                other_count + prior
            )
            log_density = log_density + np.log(share / width[bin_]) / 2
    return log_density


def _profile_bins(
    ends_mm: Float[np.ndarray, "m 2 3"],
    centre_mm: Float[np.ndarray, "*m 3"],
    axes: Float[np.ndarray, "*m 3 3"],
    tuning: OcclusionTuning,
) -> Int[np.ndarray, "m 2 3"]:
    """Return the bin of both ends of each candidate in the three profiles, (m, 2, 3).

    The first and the last bin include all positions beyond them.
    """
    centred = ends_mm - np.expand_dims(centre_mm, -2)
    coordinates = np.einsum("mej,...ij->mei" if axes.ndim == 2 else "mej,mij->mei", centred, axes)
    share = (coordinates / tuning.profile_sigmas + 1) / 2
    return np.clip(np.floor(share * BINS), 0, BINS - 1).astype(np.int64)


def _prior_profile(
    tuning: OcclusionTuning,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Return the width of each bin of a profile, and the prior probability of each bin.

    The prior is uniform in a box of unit variance, with a small probability outside.
    """
    bins, limit = BINS, tuning.profile_sigmas
    edges, half = np.linspace(-limit, limit, bins + 1), np.sqrt(3.0)
    inside = np.maximum(np.minimum(edges[1:], half) - np.maximum(edges[:-1], -half), 0.0)
    prior_share = (1 - tuning.uniform_share) * inside / inside.sum() + tuning.uniform_share / bins
    width = np.full(bins, 2 * limit / bins)
    width[[0, -1]] *= tuning.outer_bin_factor
    return width, prior_share


def _profile(
    first: Int[np.ndarray, "m"],
    second: Int[np.ndarray, "m"],
    posterior: Float[np.ndarray, "m"],
    bins: int,
    frame: Int[np.ndarray, "m"] | None,
    frames: int,
) -> Float[np.ndarray, "*f k"]:
    """Return the smoothed number of lines in each bin, (k,), for each frame of a stack.

    `first` and `second` are the bins of the two ends of each line. Each end counts half.
    """
    start = 0 if frame is None else frame * bins
    # One border bin on either side, because smoothing moves weight outward.
    end_counts = [
        np.bincount(start + bin_, posterior / 2, frames * bins) for bin_ in (first, second)
    ]
    count = np.pad((end_counts[0] + end_counts[1]).reshape(frames, bins), ((0, 0), (1, 1)))
    smooth = _CENTRE_WEIGHT * count[:, 1:-1] + _NEIGHBOUR_WEIGHT * (count[:, :-2] + count[:, 2:])
    return smooth[0] if frame is None else smooth


class PairRates(NamedTuple):
    """Parameters of the log odds of pairs, estimated by EM; one set for each frame of a stack.

    Attributes
    ----------
    ends : (c,)
        Weight of each component of the end evidence; the last component is "the ends do not
        correspond".
    log_by_length : (k,)
        Log of the share of each length class among lines over its share among clutter.
    mixture : MixtureParameters
        Density and number of lines.
    junctions : JunctionParameters
        Frequency of ends at junctions.
    log_position_density : (m,) or None
        Log density of lines at each pair; None before the first EM step.
    """

    ends: Float[np.ndarray, "*f c"]
    log_by_length: Float[np.ndarray, "*f k"]
    mixture: MixtureParameters
    junctions: JunctionParameters
    log_position_density: Float[np.ndarray, "m"] | None


def length_class(candidates: Candidates, tuning: MatchTuning) -> Int[np.ndarray, "m"]:
    """Return the length class of each candidate, by its length in the image, (m,)."""
    length_px = candidates.px_per_mm * np.linalg.norm(
        candidates.union_ends_mm[:, 1] - candidates.union_ends_mm[:, 0], axis=1
    )
    return np.searchsorted(tuning.occlusion.length_classes_px, length_px)


def learn_rates(
    candidates: Candidates,
    posterior: Float[np.ndarray, "m"],
    rates: PairRates,
    junctions: JunctionParameters,
    typical_px: Float[np.ndarray, "*f"] | float,
    tuning: MatchTuning,
) -> PairRates:
    """Run one EM step, and return the updated parameters of the log odds.

    `posterior` is the current probability of each pair. `typical_px` is the typical length of
    clutter.
    """
    rules, frames = tuning.occlusion, np.size(rates.mixture.log_count)
    frame, prior = candidates.frame, tuning.evidence.prior_observations
    terms = np.exp(candidates.end_log) * np.expand_dims(broadcast_groups(rates.ends, frame), -2)
    terms /= terms.sum(axis=2, keepdims=True)
    ends = group_sums(posterior[:, None] * terms.sum(axis=1), frame, frames)
    ends += prior * rates.ends
    # Lengths of clutter have the density t / (length + t)^2.
    class_borders = np.array([0.0, *rules.length_classes_px])
    clutter_below = class_borders / (class_borders + np.expand_dims(typical_px, -1))
    clutter_share = np.diff(clutter_below, axis=-1, append=1.0)
    in_class = np.eye(len(class_borders))[length_class(candidates, tuning)]
    count = group_sums(posterior[:, None] * in_class, frame, frames)
    line_count = group_sums(posterior, frame, frames)
    by_length = np.log(
        (count + prior * clutter_share) / (np.expand_dims(line_count + prior, -1) * clutter_share)
    )
    mixture = rates.mixture._replace(
        volume=fit_volume(candidates.ends_mm, posterior, tuning.evidence, frame, frames),
        log_count=np.log(np.maximum(line_count, 1.0)),
    )
    position_density = log_position_density_among(
        candidates.ends_mm, posterior, mixture.volume, tuning, frame
    )
    ends = ends / ends.sum(axis=-1, keepdims=True)
    return PairRates(ends, by_length, mixture, junctions, position_density)


def match_pairs_alone(
    pairs: Candidates,
    matched: Candidates,
    ends_px: Float[np.ndarray, "v n 2 2"],
    initial_rates: tuple[MixtureParameters, JunctionParameters],
    typical_px: np.ndarray | float,
    tuning: MatchTuning,
) -> Pairs:
    """Compute the posterior log odds of pairs in frames with hardly any matched line.

    All parameters are estimated from the pairs themselves. The segments of the few matched lines
    are not used again.
    """
    rules, frame = tuning.occlusion, pairs.frame
    mixture, junctions = initial_rates
    in_images = pairs.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset_alone)
    evidence = (
        pairs.log_density
        + log_sides(pairs.side_log, mixture, frame)
        + pairs.expected_views * float(np.log(rules.miss_probability))
        + offset
    )
    frames, classes = np.shape(mixture.log_count), len(rules.length_classes_px) + 1
    ends = end_shares(mixture, tuning.ends)
    rates = PairRates(ends, np.zeros((*frames, classes)), mixture, junctions, None)

    def prior_odds(c: Candidates, evidence: np.ndarray, rates: PairRates) -> np.ndarray:
        frame = c.frame
        ends = log_ends(c, broadcast_groups(rates.ends, frame))
        classes = length_class(c, tuning)
        log_ratios = broadcast_groups(rates.log_by_length, frame)
        lengths = (
            log_ratios[classes] if frame is None else log_ratios[np.arange(len(classes)), classes]
        )
        prior = broadcast_groups(rates.mixture.log_count, frame)
        position_density = rates.log_position_density
        if position_density is None:
            position_density = log_position_density(
                c.ends_mm, rates.mixture.volume, tuning.evidence, frame
            )
        return evidence + ends + lengths + prior + position_density

    selected_rows, log_share = likely_pair_rows(
        pairs, matched, prior_odds(pairs, evidence, rates), tuning
    )
    candidates, evidence = pairs.take(selected_rows), evidence[selected_rows]
    frame = candidates.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    end_pairs = endpoint_pairs(candidates, evidence, tuning.junctions, tuning.evidence)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    companion_graph, companion_gain = None, np.zeros(len(evidence))
    count = np.size(mixture.log_count)
    for _ in range(ROUNDS):
        # Without junctions, wrong pairs are independent, as the odds assume.
        unjoined_offset = 1 - broadcast_groups(rates.junctions.end_at_junction, frame)
        unjoined_offset = np.where(
            candidates.side_log.any(axis=1), 0.0, rules.offset_unjoined * unjoined_offset
        )
        odds = prior_odds(candidates, evidence, rates) + gain + unjoined_offset + companion_gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
        posterior = probability(posterior_log_odds)
        if companion_graph is None:
            likely_rows = np.flatnonzero(posterior > rules.min_companion_posterior)
            companion_graph = find_companions(candidates, likely_rows, ends_px, tuning)
        companion_gain = companion_log_odds(companion_graph, posterior, tuning, frame, count)
        density = rates.mixture.log_count - rates.mixture.volume.log_size + np.log(2)
        gain, junctions = junction_log_odds(
            end_pairs, posterior, density, rates.junctions, tuning.junctions, frame
        )
        has_junctions = junctions.end_at_junction >= tuning.junctions.min_junction_share
        gain = np.where(broadcast_groups(has_junctions, frame), gain, 0.0)
        rates = learn_rates(candidates, posterior, rates, junctions, typical_px, tuning)
    posterior_log_odds = with_log_share(posterior_log_odds, log_share)
    is_accepted = choose_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    # Lines without junctions belong to no bodies, and see-through bodies hide no edges.
    see_through = see_through_share(
        ends_px,
        candidates.index[is_accepted],
        probability(tempered[is_accepted]),
        tuning,
        take_groups(frame, is_accepted),
        count,
    )
    body_fields = junctions.end_at_junction, see_through.reshape(np.shape(mixture.log_count))
    bodies = Bodies(*(broadcast_groups(field, frame) for field in body_fields))
    pair_arguments = posterior_log_odds, candidates.side_log, candidates.crossing_sine, bodies
    tempered = temper_pairs(*pair_arguments, tuning)
    limited_posterior = rules.max_posterior_alone * probability(tempered)
    in_images = candidates.side_log.any(axis=1)
    tempered = np.where(
        in_images, tempered, np.log(limited_posterior) - np.log1p(-limited_posterior)
    )
    expected = candidates.expected_views
    miss_log_odds = np.where(expected > 0, expected * float(np.log(rules.miss_probability)), 0.0)
    return Pairs(candidates, odds, tempered, is_accepted, miss_log_odds)
