"""Step 2: which candidates are true, from their evidence, their rivals and their neighbours.

How much larger the segments' errors are than they state, learned from three views.

The residual that three views leave has a chi-square of two degrees of freedom where errors are as
stated. Its median over the triples that are surely right is nothing to the few that are wrong, and
to heavy tails.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.candidates.table import Candidates, prior_log_odds
from trinoc.match.evidence.mixture import (
    MixtureParameters,
    em_step,
    prior_parameters,
    probability,
)
from trinoc.match.observations.match_input import common_error_variance
from trinoc.match.selection.junction_support import (
    JunctionParameters,
    endpoint_pairs,
    junction_log_odds,
    prior_junctions,
)
from trinoc.match.selection.messages import (
    Beliefs,
    ConflictGraph,
    affordable,
    choose_greedily,
    conflict_graph,
    log_share_kept,
    sum_product,
    with_log_share,
)
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.joins import broadcast_groups, group_medians
from trinoc.numerics.tables import take_rows


class Selection(NamedTuple):
    """Candidates, their log odds without and with rivals, and which of them were taken.

    let_go : (n, v) segments of likely candidates that memory did not bear.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    taken: Bool[np.ndarray, "m"]
    graph: ConflictGraph
    mixture: MixtureParameters
    junctions: JunctionParameters
    let_go: Int[np.ndarray, "n v"]


class Tracks(NamedTuple):
    """Lines taken, as candidates with a segment in two or more views.

    rival_posterior : posterior log odds of the best candidate that each excluded, -inf where none.
    member_posterior : (t, v) probability that each segment is of the line of the others, NaN where
        there is none or where fewer than three others are left; None where that holds for all.
    """

    candidates: Candidates
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    member_posterior: Float[np.ndarray, "t v"] | None = None

    def take(self, rows: np.ndarray) -> "Tracks":
        """Those at the given indices, in that order, or where the mask is true."""
        return take_rows(self, rows)


def select(
    candidates: Candidates,
    typical_count: Float[np.ndarray, "f"] | float,
    *,
    neighbours: bool = True,
    tuning: MatchTuning = DEFAULT,
) -> Selection:
    """Fit the mixture parameters by EM, and take candidates in order of posterior log odds.

    Without `neighbours`, junctions add nothing: only a candidate's evidence and its rivals count.
    Candidates of a stack have the parameters of their own frame, and each frame has its
    `typical_count` of segments.
    """
    evidence, rules = tuning.evidence, tuning.selection
    mixture = prior_parameters(candidates.ends_mm, typical_count, tuning, candidates.frame)
    # EM on the likely candidates alone: far fewer, with far fewer conflicts.
    odds = prior_log_odds(candidates, mixture, evidence)
    keep = affordable(odds, candidates.index, rules.learn_log_odds, rules)
    likely = candidates.take(keep)
    graph = conflict_graph(likely.index, likely.interval, rules)
    beliefs = None
    for _ in range(rules.rounds):
        odds = prior_log_odds(likely, mixture, evidence)
        beliefs = sum_product(odds, graph, rules, likely.frame, beliefs)
        c, posterior = likely, probability(beliefs.log_odds)
        mixture = em_step(
            c.chi_square, c.end_log, c.ends_mm, c.side_log, posterior, mixture, tuning, c.frame
        )
    odds = prior_log_odds(candidates, mixture, evidence)
    possible = np.flatnonzero(odds > rules.prune_log_odds)
    keep = affordable(odds, candidates.index, rules.prune_log_odds, rules)
    log_share, let_go = np.zeros(len(keep)), candidates.index[np.setdiff1d(possible, keep)]
    if len(keep) < len(possible):
        log_share = log_share_kept(
            odds[possible], candidates.index[possible], np.searchsorted(possible, keep)
        )
    candidates, odds = candidates.take(keep), odds[keep]
    graph = conflict_graph(candidates.index, candidates.interval, rules)
    beliefs = sum_product(odds, graph, rules, candidates.frame)
    posterior_log_odds = beliefs.log_odds
    junctions = prior_junctions(tuning.junctions, np.shape(mixture.log_count))
    if neighbours:
        odds, posterior_log_odds, junctions = _with_junctions(
            candidates, graph, odds, beliefs, mixture, tuning
        )
    posterior_log_odds = with_log_share(posterior_log_odds, log_share)
    return Selection(
        candidates,
        odds,
        posterior_log_odds,
        choose_greedily(posterior_log_odds, graph),
        graph,
        mixture,
        junctions,
        let_go,
    )


def take_tracks(selection: Selection) -> Tracks:
    """What was taken, with the posterior log odds of the best rival of each."""
    graph = selection.graph
    rival_posterior = np.full(len(selection.posterior_log_odds), -np.inf)
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    if len(first):
        of_rivals = selection.posterior_log_odds[rival]
        rival_posterior[owner[first]] = np.maximum.reduceat(of_rivals, first)
    chosen = selection.taken
    return Tracks(
        selection.candidates.take(chosen),
        selection.posterior_log_odds[chosen],
        rival_posterior[chosen],
    )


def _with_junctions(
    candidates: Candidates,
    graph: ConflictGraph,
    odds: Float[np.ndarray, "m"],
    beliefs: Beliefs,
    mixture: MixtureParameters,
    tuning: MatchTuning,
) -> tuple[Float[np.ndarray, "m"], Float[np.ndarray, "m"], JunctionParameters]:
    frame = candidates.frame
    meetings = endpoint_pairs(candidates, odds, tuning.junctions, tuning.evidence)
    junctions = prior_junctions(tuning.junctions, np.shape(mixture.log_count))
    log_ends_density = mixture.log_count - mixture.volume.log_size + np.log(2)
    alone = odds, beliefs.log_odds
    for _ in range(tuning.selection.junction_rounds):
        gain, junctions = junction_log_odds(
            meetings,
            probability(beliefs.log_odds),
            log_ends_density,
            junctions,
            tuning.junctions,
            frame,
        )
        odds = alone[0] + gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
    helped = broadcast_groups(junctions.end_at_junction >= tuning.junctions.min_at_junction, frame)
    odds, posterior_log_odds = (
        np.where(helped, one, other)
        for one, other in zip((odds, beliefs.log_odds), alone, strict=True)
    )
    return odds, posterior_log_odds, junctions


def residual_scale(
    selections: Sequence[Selection],
    across_px2: Float[np.ndarray, "v n 2 2"],
    frames: int = 1,
    tuning: NoiseTuning = DEFAULT.noise,
) -> Float[np.ndarray, "f"]:
    """Standard deviation of segments across themselves, over what they state, of each frame.

    Few triples say little: as many as `prior_observations` that fit as stated count with them.
    Triples of segments `across_px2` whose errors are mostly common to the edge's pictures say
    nothing.
    """
    both = across_px2.sum(axis=(2, 3)) / 4
    common = np.stack([common_error_variance(own) for own in across_px2])
    tells = common < tuning.common_share * both
    share = (np.arange(tuning.prior_observations) + 0.5) / tuning.prior_observations
    prior = -2 * np.log1p(-share)  # the quantiles of chi-square with two degrees of freedom
    chi_square, frame = [np.tile(prior, frames)], [np.repeat(np.arange(frames), len(prior))]
    for selection in selections:
        sure = selection.taken & (probability(selection.posterior_log_odds) > tuning.sure)
        index = selection.candidates.index[sure]
        of_views = np.take_along_axis(tells.T, np.maximum(index, 0), axis=0)
        sure[sure] = (of_views | (index < 0)).all(axis=1)
        chi_square.append(selection.candidates.chi_square[sure])
        own = selection.candidates.frame
        every = np.zeros(len(sure), int) if own is None else own
        frame.append(every[sure])
    typical = group_medians(np.concatenate(chi_square), np.concatenate(frame), frames)
    scale = np.sqrt(typical / (2 * np.log(2)))
    return np.clip(scale, 1 / tuning.largest, tuning.largest)


def learn_noise_scale(
    selections: Sequence[Selection],
    across_px2: Float[np.ndarray, "v n 2 2"],
    before: Float[np.ndarray, "f"],
    tuning: NoiseTuning,
) -> tuple[Float[np.ndarray, "f"], Bool[np.ndarray, "f"]]:
    """(scale of each frame's errors over what is stated, whether that is so far from the scale
    `before`, under which candidates were found, that they are to be found again)."""
    larger = residual_scale(selections, across_px2, len(before), tuning) if selections else 1.0
    scale = np.clip(before * larger, 1 / tuning.most, tuning.most)
    change = scale / before
    return scale, (change >= tuning.again_above) | (change <= tuning.again_below)
