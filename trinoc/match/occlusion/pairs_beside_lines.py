"""Pairs beside lines that three views show: the strong evidence is that their ends meet these."""

import numpy as np

from trinoc.match.candidates import Candidates
from trinoc.match.evidence import probability
from trinoc.match.occlusion.pair_evidence import (
    Pairs,
    PairsBeside,
    PairStart,
    evidence_beside_lines,
    likely_rows,
)
from trinoc.match.occlusion.solids import Bodies, tempered_pairs
from trinoc.match.selection import (
    chosen_greedily,
    conflict_graph,
    endpoint_pairs,
    junction_log_odds,
    sum_product,
)
from trinoc.match.tuning import MatchTuning
from trinoc.numerics import broadcast_groups, concatenate_rows, group_sums


def pairs_beside_lines(
    beside: PairsBeside, start: PairStart, typical_px: np.ndarray | float, tuning: MatchTuning
) -> Pairs:
    """Posterior log odds of pairs among lines that are matched already, to a fixed point."""
    rules = tuning.occlusion
    log_missed = float(np.log(rules.missed))
    mixture, junctions = start
    evidence = evidence_beside_lines(beside.found, mixture, beside.frame, tuning)
    keep = likely_rows(beside, evidence, tuning)
    beside, evidence = beside.take(keep), evidence[keep]
    (candidates, expected, crossing_sine), frame = beside.found, beside.frame
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
    helped = broadcast_groups(junctions.end_at_junction >= tuning.junctions.min_at_junction, frame)
    gain = np.zeros(len(evidence))
    odds = posterior_log_odds = gain
    beliefs = None
    for _ in range(rules.rounds):
        odds = evidence + broadcast_groups(np.log(share), frame) + gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
        posterior_log_odds = beliefs.log_odds
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
    of_share = broadcast_groups(np.log(share), frame)
    missed = np.where(expected > 0, expected * log_missed + of_share, 0.0)
    chosen = chosen_greedily(posterior_log_odds, graph)
    bodies = Bodies(*(broadcast_groups(each, frame) for each in beside.bodies))
    of_pair = posterior_log_odds, candidates.side_log, crossing_sine, bodies
    tempered = tempered_pairs(*of_pair, tuning)
    return Pairs(candidates, odds, tempered, chosen, missed)


def _joined(matched: Candidates, pairs: Candidates) -> Candidates:
    # The ends' own evidence has been counted, and differs in shape.
    matched, pairs = (c._replace(end_log=np.zeros((len(c.index), 2, 0))) for c in (matched, pairs))
    return concatenate_rows([matched, pairs])
