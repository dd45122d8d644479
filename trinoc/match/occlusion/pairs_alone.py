"""Pairs where hardly any line is seen in three views: they themselves say how they are."""

import numpy as np

from trinoc.match.evidence import log_place, log_sides, probability, temper
from trinoc.match.occlusion.companions import companion_log_odds, companions
from trinoc.match.occlusion.pair_evidence import (
    Pairs,
    PairsBeside,
    PairStart,
    end_shares,
    likely_rows,
    log_ends,
)
from trinoc.match.occlusion.possible_pairs import PossiblePairs
from trinoc.match.occlusion.see_through import see_through_share
from trinoc.match.occlusion.solids import Bodies, tempered_pairs
from trinoc.match.occlusion.two_views import PairRates, learned_rates, length_class
from trinoc.match.selection import (
    chosen_greedily,
    conflict_graph,
    endpoint_pairs,
    junction_log_odds,
    sum_product,
)
from trinoc.match.tuning import MatchTuning
from trinoc.numerics import broadcast_groups, take_groups


def pairs_alone(
    beside: PairsBeside, start: PairStart, typical_px: np.ndarray | float, tuning: MatchTuning
) -> Pairs:
    """Posterior log odds of pairs whose rates are learned from them, round by round."""
    rules = tuning.occlusion
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
    rates = PairRates(ends, np.zeros((*frames, classes)), mixture, junctions, None)

    def odds_of(
        found: PossiblePairs, evidence: np.ndarray, rates: PairRates, frame: np.ndarray | None
    ) -> np.ndarray:
        c = found.candidates
        ends = log_ends(c, broadcast_groups(rates.ends, frame))
        classes = length_class(c, tuning)
        every = broadcast_groups(rates.log_by_length, frame)
        lengths = every[classes] if frame is None else every[np.arange(len(classes)), classes]
        prior = broadcast_groups(rates.mixture.log_count, frame)
        place = rates.log_place
        if place is None:
            place = log_place(c.ends_mm, rates.mixture.volume, tuning.evidence, frame)
        return evidence + ends + lengths + prior + place

    keep = likely_rows(beside, odds_of(found, evidence, rates, frame), tuning)
    beside, evidence = beside.take(keep), evidence[keep]
    found, frame = beside.found, beside.frame
    candidates, expected, crossing_sine = found
    graph = conflict_graph(candidates.index, candidates.interval, tuning.selection)
    meetings = endpoint_pairs(candidates, tuning.junctions, tuning.evidence, frame)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    graph_of_companions, more = None, np.zeros(len(evidence))
    count = np.size(mixture.log_count)
    for _ in range(rules.rounds_alone):
        # Where lines meet nowhere, what pairs they make by chance is independent, as odds take it.
        free = 1 - broadcast_groups(rates.junctions.end_at_junction, frame)
        free = np.where(candidates.side_log.any(axis=1), 0.0, rules.offset_unjoined * free)
        odds = odds_of(found, evidence, rates, frame) + gain + free + more
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
        posterior = probability(posterior_log_odds)
        if graph_of_companions is None:
            likely = np.flatnonzero(posterior > rules.companion_likely)
            graph_of_companions = companions(candidates, likely, beside.ends_px, tuning, frame)
        more = companion_log_odds(graph_of_companions, posterior, rules, frame, count)
        density = rates.mixture.log_count - rates.mixture.volume.log_size + np.log(2)
        gain, junctions = junction_log_odds(
            meetings, posterior, density, rates.junctions, tuning.junctions, frame
        )
        helped = junctions.end_at_junction >= tuning.junctions.min_at_junction
        gain = np.where(broadcast_groups(helped, frame), gain, 0.0)
        rates = learned_rates(candidates, posterior, rates, junctions, typical_px, tuning, frame)
    chosen = chosen_greedily(posterior_log_odds, graph)
    tempered = temper(posterior_log_odds, candidates.side_log, tuning.evidence)
    # Lines that meet nowhere are of no bodies, and bodies that are seen through hide no edges.
    through = see_through_share(
        beside.ends_px,
        candidates.index[chosen],
        probability(tempered[chosen]),
        rules,
        take_groups(frame, chosen),
        count,
    )
    every = junctions.end_at_junction, through.reshape(np.shape(mixture.log_count))
    bodies = Bodies(*(broadcast_groups(each, frame) for each in every))
    of_pair = posterior_log_odds, candidates.side_log, crossing_sine, bodies
    tempered = tempered_pairs(*of_pair, tuning)
    most = rules.most_alone * probability(tempered)
    in_images = candidates.side_log.any(axis=1)
    tempered = np.where(in_images, tempered, np.log(most) - np.log1p(-most))
    missed = np.where(expected > 0, expected * float(np.log(rules.missed)), 0.0)
    return Pairs(candidates, odds, tempered, chosen, missed)
