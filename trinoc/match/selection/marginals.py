"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.candidates import Candidates, prior_log_odds
from trinoc.match.evidence import MixtureParameters, em_step, prior_parameters, probability, temper
from trinoc.match.selection.exclusivity import (
    ConflictGraph,
    chosen_greedily,
    conflict_graph,
    sum_product,
)
from trinoc.match.selection.junction_support import (
    PRIOR_PARAMETERS,
    JunctionParameters,
    endpoint_pairs,
    junction_log_odds,
)

ROUNDS = 4
JUNCTION_ROUNDS = 4
# Candidates with prior log odds below these are dropped: during EM, and after it.
LEARN_LOG_ODDS, PRUNE_LOG_ODDS = -2.0, -5.0
# With fewer junctions than this share of ends there is no structure to speak of.
MIN_AT_JUNCTION = 0.1


class Selection(NamedTuple):
    """Candidates, their log odds without and with rivals, and which of them were taken."""

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    graph: ConflictGraph
    mixture: MixtureParameters
    junctions: JunctionParameters


class Tracks(NamedTuple):
    """Lines taken, as candidates with a segment in two or more views.

    rival_posterior : posterior log odds of the best candidate that each excluded, -inf where none.
    """

    candidates: Candidates
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]


def select(candidates: Candidates, typical_count: float, *, neighbours: bool = True) -> Selection:
    """Fit the mixture parameters by EM, and take candidates in order of posterior log odds.

    Without `neighbours`, junctions add nothing: only a candidate's evidence and its rivals count.
    """
    mixture = prior_parameters(candidates.ends_mm, typical_count)
    # EM on the likely candidates alone: far fewer, with far fewer conflicts.
    likely = _above(candidates, prior_log_odds(candidates, mixture), LEARN_LOG_ODDS)
    graph = conflict_graph(likely.index, likely.interval)
    for _ in range(ROUNDS):
        posterior_log_odds = sum_product(prior_log_odds(likely, mixture), graph)
        mixture = _learned(likely, posterior_log_odds, mixture)
    candidates = _above(candidates, prior_log_odds(candidates, mixture), PRUNE_LOG_ODDS)
    graph = conflict_graph(candidates.index, candidates.interval)
    odds = prior_log_odds(candidates, mixture)
    posterior_log_odds = sum_product(odds, graph)
    junctions = PRIOR_PARAMETERS
    if neighbours:
        odds, posterior_log_odds, junctions = _with_junctions(
            candidates, graph, odds, posterior_log_odds, mixture
        )
    return Selection(
        candidates,
        odds,
        posterior_log_odds,
        chosen_greedily(posterior_log_odds, graph),
        graph,
        mixture,
        junctions,
    )


def tracks_of(selection: Selection) -> Tracks:
    """What was taken, with the posterior log odds of the best rival of each, tempered."""
    graph = selection.graph
    rival_posterior = np.full(len(selection.posterior_log_odds), -np.inf)
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    np.maximum.at(rival_posterior, owner, selection.posterior_log_odds[rival])
    taken = selection.taken
    candidates = Candidates(*(field[taken] for field in selection.candidates))
    posterior_log_odds, rivals = (
        temper(values[taken], candidates.side_log)
        for values in (selection.posterior_log_odds, rival_posterior)
    )
    return Tracks(candidates, posterior_log_odds, rivals)


def _with_junctions(
    candidates: Candidates,
    graph: ConflictGraph,
    odds: Float[np.ndarray, "m"],
    posterior_log_odds: Float[np.ndarray, "m"],
    mixture: MixtureParameters,
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"], JunctionParameters]:
    meetings, junctions = endpoint_pairs(candidates), PRIOR_PARAMETERS
    log_ends_density = mixture.log_count - mixture.volume.log_size + np.log(2)
    alone = odds, posterior_log_odds
    for _ in range(JUNCTION_ROUNDS):
        gain, junctions = junction_log_odds(
            meetings, probability(posterior_log_odds), log_ends_density, junctions
        )
        odds = alone[0] + gain
        posterior_log_odds = sum_product(odds, graph)
    if junctions.end_at_junction < MIN_AT_JUNCTION:
        return *alone, junctions
    return odds, posterior_log_odds, junctions


def _above(candidates: Candidates, odds: Float[np.ndarray, "m"], least: float) -> Candidates:
    return Candidates(*(field[odds > least] for field in candidates))


def _learned(
    candidates: Candidates, posterior_log_odds: Float[np.ndarray, "m"], mixture: MixtureParameters
) -> MixtureParameters:
    c = candidates
    return em_step(
        c.chi_square, c.end_log, c.ends_mm, c.side_log, probability(posterior_log_odds), mixture
    )
