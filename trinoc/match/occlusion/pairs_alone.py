"""Pairs where hardly any line is seen in three views: they themselves say how they are.

Where lines lie, learned from two views alone: profiles along the axes of their spread.

A wrong pair lies anywhere along its viewing rays, before the scene and behind it. No third view
says so, but right ones lie where the others do. A box of their spread, which is enough for triples,
is too coarse for that: the wrong ones among them make it larger.

What two views alone teach about pairs: how many lines of each length, how ends agree, junctions.

No third view checks a pair, so that its odds are as good as the rates that they are compared with.
These are learned from all candidates by EM: pieces that a detector broke are short, and seldom have
a partner in the other view; in a scene without junctions, ends meet by chance.
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
from trinoc.match.occlusion.companions import companion_log_odds, companions
from trinoc.match.occlusion.possible_pairs import (
    Pairs,
    end_shares,
    likely_rows,
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

# numerical: shares of a line's weight in its own bin of a profile and in each of the two beside
# it.
_OWN, _BESIDE = 0.5, 0.25
# numerical: bins of a profile.
BINS = 32
# numerical: rounds of EM, which converge.
ROUNDS = 10


def log_place_among(
    ends_mm: Float[np.ndarray, "m 2 3"],
    posterior: Float[np.ndarray, "m"],
    volume: Volume,
    tuning: MatchTuning,
    frame: Int[np.ndarray, "m"] | None = None,
) -> Float[np.ndarray, "m"]:
    """Log density of a line at each place, per volume (mm^3) and direction (of 2 pi).

    The density is that of the other lines, weighted by their posteriors: a line alone somewhere
    does not say that lines lie there. It is a product of profiles along the axes of `volume`, and
    of a line the geometric mean of that at its ends.
    """
    # The directions of the axes, and standard deviations along them.
    square, turn = np.linalg.eigh(volume.precision)
    axes = np.sqrt(square)[..., None] * turn.mT
    place = _bins(
        ends_mm,
        broadcast_groups(volume.centre_mm, frame),
        broadcast_groups(axes, frame),
        tuning.occlusion,
    )
    width, usual = _empty_profile(tuning.occlusion)
    frames, prior = np.size(volume.log_size), tuning.evidence.prior_observations
    others = broadcast_groups(group_sums(posterior, frame, frames), frame) - posterior
    # Of the volume that coordinates of unit variance span, to that in mm^3.
    total = broadcast_groups(0.5 * np.log(square).sum(axis=-1), frame) - np.log(2 * np.pi)
    for axis in range(3):
        first, second = place[:, :, axis].T
        shared = np.where(first == second, _OWN, np.where(abs(first - second) == 1, _BESIDE, 0.0))
        own = posterior / 2 * (_OWN + shared)
        profile = _profile(first, second, posterior, BINS, frame, frames)
        for bin_ in (first, second):
            count = profile[bin_] if frame is None else profile[frame, bin_]
            share = (np.maximum(count - own, 0.0) + prior * usual[bin_]) / (others + prior)
            total = total + np.log(share / width[bin_]) / 2
    return total


def _bins(
    ends_mm: Float[np.ndarray, "m 2 3"],
    centre_mm: Float[np.ndarray, "*m 3"],
    axes: Float[np.ndarray, "*m 3 3"],
    tuning: OcclusionTuning,
) -> Int[np.ndarray, "m 2 3"]:
    """The bin of both ends in each coordinate; the outermost hold all beyond."""
    centred = ends_mm - np.expand_dims(centre_mm, -2)
    place = np.einsum("mej,...ij->mei" if axes.ndim == 2 else "mej,mij->mei", centred, axes)
    share = (place / tuning.place_reach + 1) / 2
    return np.clip(np.floor(share * BINS), 0, BINS - 1).astype(np.int64)


def _empty_profile(
    tuning: OcclusionTuning,
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """(width of each bin, share of each before any line is known: a box, and a few beyond)."""
    bins, reach = BINS, tuning.place_reach
    edges, half = np.linspace(-reach, reach, bins + 1), np.sqrt(3.0)
    inside = np.maximum(np.minimum(edges[1:], half) - np.maximum(edges[:-1], -half), 0.0)
    usual = (1 - tuning.place_anywhere) * inside / inside.sum() + tuning.place_anywhere / bins
    width = np.full(bins, 2 * reach / bins)
    width[[0, -1]] *= tuning.place_beyond
    return width, usual


def _profile(
    first: Int[np.ndarray, "m"],
    second: Int[np.ndarray, "m"],
    posterior: Float[np.ndarray, "m"],
    bins: int,
    frame: Int[np.ndarray, "m"] | None,
    frames: int,
) -> Float[np.ndarray, "*f k"]:
    """How many lines there are in each bin, both ends of a line half each, smoothed."""
    start = 0 if frame is None else frame * bins
    # A border of one bin on either side takes what smoothing carries out.
    each = [np.bincount(start + bin_, posterior / 2, frames * bins) for bin_ in (first, second)]
    count = np.pad((each[0] + each[1]).reshape(frames, bins), ((0, 0), (1, 1)))
    smooth = _OWN * count[:, 1:-1] + _BESIDE * (count[:, :-2] + count[:, 2:])
    return smooth[0] if frame is None else smooth


class PairRates(NamedTuple):
    """ends : shares of the components of each end, the last is "none agree".
    log_by_length : log of lines of each class of length over what clutter's lengths say.
    mixture : where lines are and how many. junctions : how often ends meet."""

    ends: Float[np.ndarray, "*f c"]
    log_by_length: Float[np.ndarray, "*f k"]
    mixture: MixtureParameters
    junctions: JunctionParameters
    log_place: Float[np.ndarray, "m"] | None


def length_class(candidates: Candidates, tuning: MatchTuning) -> Int[np.ndarray, "m"]:
    """The class of length, in the image, of each candidate."""
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
    """One round of EM, in each frame."""
    rules, frames = tuning.occlusion, np.size(rates.mixture.log_count)
    frame, prior = candidates.frame, tuning.evidence.prior_observations
    terms = np.exp(candidates.end_log) * np.expand_dims(broadcast_groups(rates.ends, frame), -2)
    terms /= terms.sum(axis=2, keepdims=True)
    ends = group_sums(posterior[:, None] * terms.sum(axis=1), frame, frames)
    ends += prior * rates.ends
    # Clutter's lengths are spread as t / (length + t)^2.
    borders = np.array([0.0, *rules.length_classes_px])
    below = borders / (borders + np.expand_dims(typical_px, -1))
    usual = np.diff(below, axis=-1, append=1.0)
    in_class = np.eye(len(borders))[length_class(candidates, tuning)]
    count = group_sums(posterior[:, None] * in_class, frame, frames)
    total = group_sums(posterior, frame, frames)
    by_length = np.log((count + prior * usual) / (np.expand_dims(total + prior, -1) * usual))
    mixture = rates.mixture._replace(
        volume=fit_volume(candidates.ends_mm, posterior, tuning.evidence, frame, frames),
        log_count=np.log(np.maximum(total, 1.0)),
    )
    place = log_place_among(candidates.ends_mm, posterior, mixture.volume, tuning, frame)
    ends = ends / ends.sum(axis=-1, keepdims=True)
    return PairRates(ends, by_length, mixture, junctions, place)


def pairs_alone(
    found: Candidates,
    matched: Candidates,
    ends_px: Float[np.ndarray, "v n 2 2"],
    start: tuple[MixtureParameters, JunctionParameters],
    typical_px: np.ndarray | float,
    tuning: MatchTuning,
) -> Pairs:
    """Posterior log odds of pairs whose rates are learned from them, round by round; the few lines
    that are matched keep their segments."""
    rules, frame = tuning.occlusion, found.frame
    mixture, junctions = start
    in_images = found.side_log.any(axis=1)
    offset = np.where(in_images, rules.log_odds_offset_in_images, rules.log_odds_offset_alone)
    evidence = (
        found.log_density
        + log_sides(found.side_log, mixture, frame)
        + found.expected_views * float(np.log(rules.missed))
        + offset
    )
    frames, classes = np.shape(mixture.log_count), len(rules.length_classes_px) + 1
    ends = end_shares(mixture, tuning.ends)
    rates = PairRates(ends, np.zeros((*frames, classes)), mixture, junctions, None)

    def prior_odds(c: Candidates, evidence: np.ndarray, rates: PairRates) -> np.ndarray:
        frame = c.frame
        ends = log_ends(c, broadcast_groups(rates.ends, frame))
        classes = length_class(c, tuning)
        every = broadcast_groups(rates.log_by_length, frame)
        lengths = every[classes] if frame is None else every[np.arange(len(classes)), classes]
        prior = broadcast_groups(rates.mixture.log_count, frame)
        place = rates.log_place
        if place is None:
            place = log_position_density(c.ends_mm, rates.mixture.volume, tuning.evidence, frame)
        return evidence + ends + lengths + prior + place

    keep, log_share = likely_rows(found, matched, prior_odds(found, evidence, rates), tuning)
    candidates, evidence = found.take(keep), evidence[keep]
    frame = candidates.frame
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    meetings = endpoint_pairs(candidates, evidence, tuning.junctions, tuning.evidence)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    graph_of_companions, more = None, np.zeros(len(evidence))
    count = np.size(mixture.log_count)
    for _ in range(ROUNDS):
        # Where lines meet nowhere, what pairs they make by chance is independent, as odds take it.
        free = 1 - broadcast_groups(rates.junctions.end_at_junction, frame)
        free = np.where(candidates.side_log.any(axis=1), 0.0, rules.offset_unjoined * free)
        odds = prior_odds(candidates, evidence, rates) + gain + free + more
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
        posterior = probability(posterior_log_odds)
        if graph_of_companions is None:
            likely = np.flatnonzero(posterior > rules.companion_likely)
            graph_of_companions = companions(candidates, likely, ends_px, tuning)
        more = companion_log_odds(graph_of_companions, posterior, tuning, frame, count)
        density = rates.mixture.log_count - rates.mixture.volume.log_size + np.log(2)
        gain, junctions = junction_log_odds(
            meetings, posterior, density, rates.junctions, tuning.junctions, frame
        )
        helped = junctions.end_at_junction >= tuning.junctions.min_at_junction
        gain = np.where(broadcast_groups(helped, frame), gain, 0.0)
        rates = learn_rates(candidates, posterior, rates, junctions, typical_px, tuning)
    posterior_log_odds = with_log_share(posterior_log_odds, log_share)
    chosen = choose_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    # Lines that meet nowhere are of no bodies, and bodies that are seen through hide no edges.
    through = see_through_share(
        ends_px,
        candidates.index[chosen],
        probability(tempered[chosen]),
        tuning,
        take_groups(frame, chosen),
        count,
    )
    every = junctions.end_at_junction, through.reshape(np.shape(mixture.log_count))
    bodies = Bodies(*(broadcast_groups(each, frame) for each in every))
    of_pair = posterior_log_odds, candidates.side_log, candidates.crossing_sine, bodies
    tempered = temper_pairs(*of_pair, tuning)
    most = rules.most_alone * probability(tempered)
    in_images = candidates.side_log.any(axis=1)
    tempered = np.where(in_images, tempered, np.log(most) - np.log1p(-most))
    expected = candidates.expected_views
    missed = np.where(expected > 0, expected * float(np.log(rules.missed)), 0.0)
    return Pairs(candidates, odds, tempered, chosen, missed)
