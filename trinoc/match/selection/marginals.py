"""Step 2 of the paper: posterior of each candidate from its evidence, its rivals and its
neighbours.

The same step estimates the noise scale, from three views. If errors are as stated, the residual
of three views has a chi-square distribution with two degrees of freedom. The median over the
sure triples is robust against wrong triples and heavy tails.
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
    choose_greedily,
    conflict_graph,
    log_kept_share,
    rows_within_memory,
    sum_product,
    with_log_share,
)
from trinoc.match.tuning.every_group import DEFAULT, MatchTuning
from trinoc.match.tuning.selection import NoiseTuning
from trinoc.numerics.joins import broadcast_groups, group_medians
from trinoc.numerics.tables import take_rows


class Selection(NamedTuple):
    """Candidates of three views with their posterior, and the parameters estimated from them.

    Rivals are candidates that use the same part of a segment; at most one of them is right.

    Attributes
    ----------
    candidates : Candidates
        The candidates.
    log_odds : (m,)
        Log odds before the exclusion of rivals.
    posterior_log_odds : (m,)
        Log odds after the exclusion of rivals.
    is_accepted : (m,)
        True for the accepted candidates, of which no two are rivals.
    graph : ConflictGraph
        Pairs of rivals.
    mixture : MixtureParameters
        Mixture parameters.
    junctions : JunctionParameters
        Junction parameters.
    discarded_index : (n, v)
        Segments of likely candidates that were discarded to limit the memory.
    """

    candidates: Candidates
    log_odds: Float[np.ndarray, "m"]
    posterior_log_odds: Float[np.ndarray, "m"]
    is_accepted: Bool[np.ndarray, "m"]
    graph: ConflictGraph
    mixture: MixtureParameters
    junctions: JunctionParameters
    discarded_index: Int[np.ndarray, "n v"]


class Tracks(NamedTuple):
    """Accepted candidates, each with a segment in two or more views.

    Attributes
    ----------
    candidates : Candidates
        The candidates.
    posterior_log_odds : (t,)
        Posterior log odds.
    rival_posterior : (t,)
        Posterior log odds of the best rival, a candidate that uses the same part of a segment; -inf
        if there is none.
    member_posterior : (t, v) or None
        Probability that each segment belongs to the line of the track's other segments. NaN for
        views without a segment and for tracks in fewer than four views. None if all values are NaN.
    """

    candidates: Candidates
    posterior_log_odds: Float[np.ndarray, "t"]
    rival_posterior: Float[np.ndarray, "t"]
    member_posterior: Float[np.ndarray, "t v"] | None = None

    def take(self, rows: np.ndarray) -> "Tracks":
        """Return the tracks with the given indices, or the tracks for which a mask is true."""
        return take_rows(self, rows)


def select(
    candidates: Candidates,
    typical_count: Float[np.ndarray, "f"] | float,
    *,
    neighbours: bool = True,
    tuning: MatchTuning = DEFAULT,
) -> Selection:
    """Compute the posteriors of candidates, and accept the most likely of competing candidates.

    Candidates compete if they use the same part of a segment.

    Parameters
    ----------
    candidates : Candidates
        Candidates of one frame or of a stack of frames. In a stack, each frame has its own
        parameters.
    typical_count : float or (f,)
        Number of segments per view, for each frame.
    neighbours : bool
        False to ignore junctions between candidates.
    tuning : MatchTuning
        Tuned constants.

    Returns
    -------
    Selection
        Log odds, accepted candidates, and the parameters that EM estimated.
    """
    evidence, selection_tuning = tuning.evidence, tuning.selection
    mixture = prior_parameters(candidates.ends_mm, typical_count, tuning, candidates.frame)
    # EM uses only the likely candidates, which are far fewer and have far fewer conflicts.
    odds = prior_log_odds(candidates, mixture, evidence)
    selected_rows = rows_within_memory(
        odds, candidates.index, selection_tuning.learn_log_odds, selection_tuning
    )
    likely = candidates.take(selected_rows)
    graph = conflict_graph(likely.index, likely.interval, selection_tuning)
    beliefs = None
    for _ in range(selection_tuning.em_rounds):
        odds = prior_log_odds(likely, mixture, evidence)
        beliefs = sum_product(odds, graph, selection_tuning, likely.frame, beliefs)
        c, posterior = likely, probability(beliefs.log_odds)
        mixture = em_step(
            c.chi_square, c.end_log, c.ends_mm, c.side_log, posterior, mixture, tuning, c.frame
        )
    odds = prior_log_odds(candidates, mixture, evidence)
    possible_rows = np.flatnonzero(odds > selection_tuning.prune_log_odds)
    selected_rows = rows_within_memory(
        odds, candidates.index, selection_tuning.prune_log_odds, selection_tuning
    )
    log_share = np.zeros(len(selected_rows))
    discarded_index = candidates.index[np.setdiff1d(possible_rows, selected_rows)]
    if len(selected_rows) < len(possible_rows):
        log_share = log_kept_share(
            odds[possible_rows],
            candidates.index[possible_rows],
            np.searchsorted(possible_rows, selected_rows),
        )
    candidates, odds = candidates.take(selected_rows), odds[selected_rows]
    graph = conflict_graph(candidates.index, candidates.interval, selection_tuning)
    beliefs = sum_product(odds, graph, selection_tuning, candidates.frame)
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
        discarded_index,
    )


def selected_tracks(selection: Selection) -> Tracks:
    """Return the accepted candidates as tracks, with the log odds of the best rival of each."""
    graph = selection.graph
    rival_posterior = np.full(len(selection.posterior_log_odds), -np.inf)
    owner, rival = graph.slot // graph.views, graph.rival_slot // graph.views
    first = np.flatnonzero(np.diff(owner, prepend=-1))
    if len(first):
        rival_log_odds = selection.posterior_log_odds[rival]
        rival_posterior[owner[first]] = np.maximum.reduceat(rival_log_odds, first)
    is_accepted = selection.is_accepted
    return Tracks(
        selection.candidates.take(is_accepted),
        selection.posterior_log_odds[is_accepted],
        rival_posterior[is_accepted],
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
    end_pairs = endpoint_pairs(candidates, odds, tuning.junctions, tuning.evidence)
    junctions = prior_junctions(tuning.junctions, np.shape(mixture.log_count))
    log_ends_density = mixture.log_count - mixture.volume.log_size + np.log(2)
    without_junctions = odds, beliefs.log_odds
    for _ in range(tuning.selection.junction_rounds):
        gain, junctions = junction_log_odds(
            end_pairs,
            probability(beliefs.log_odds),
            log_ends_density,
            junctions,
            tuning.junctions,
            frame,
        )
        odds = without_junctions[0] + gain
        beliefs = sum_product(odds, graph, tuning.selection, frame, beliefs)
    has_junctions = broadcast_groups(
        junctions.end_at_junction >= tuning.junctions.min_junction_share, frame
    )
    odds, posterior_log_odds = (
        np.where(has_junctions, with_gain, without_gain)
        for with_gain, without_gain in zip((odds, beliefs.log_odds), without_junctions, strict=True)
    )
    return odds, posterior_log_odds, junctions


def residual_scale(
    selections: Sequence[Selection],
    across_px2: Float[np.ndarray, "v n 2 2"],
    frames: int = 1,
    tuning: NoiseTuning = DEFAULT.noise,
) -> Float[np.ndarray, "f"]:
    """Estimate the factor between actual and assumed errors across the segments, for each frame,
    (f,).

    The estimate follows from the median chi-square of the triples with a posterior above 0.9.
    Triples whose errors are mostly common to both ends of their segments are ignored, because such
    errors cause no residual. `across_px2` is the assumed covariance. The prior is equal to
    `prior_observations` additional triples with a factor of 1.
    """
    mean_variance = across_px2.sum(axis=(2, 3)) / 4
    common_variance = np.stack([common_error_variance(view) for view in across_px2])
    is_informative = common_variance < tuning.common_share * mean_variance
    quantile = (np.arange(tuning.prior_observations) + 0.5) / tuning.prior_observations
    prior = -2 * np.log1p(-quantile)  # quantiles of chi-square with two degrees of freedom
    chi_square, frame = [np.tile(prior, frames)], [np.repeat(np.arange(frames), len(prior))]
    for selection in selections:
        is_sure = selection.is_accepted & (
            probability(selection.posterior_log_odds) > tuning.sure_posterior
        )
        index = selection.candidates.index[is_sure]
        member_is_informative = np.take_along_axis(is_informative.T, np.maximum(index, 0), axis=0)
        is_sure[is_sure] = (member_is_informative | (index < 0)).all(axis=1)
        chi_square.append(selection.candidates.chi_square[is_sure])
        candidate_frame = selection.candidates.frame
        frame_label = np.zeros(len(is_sure), int) if candidate_frame is None else candidate_frame
        frame.append(frame_label[is_sure])
    median_chi_square = group_medians(np.concatenate(chi_square), np.concatenate(frame), frames)
    scale = np.sqrt(median_chi_square / (2 * np.log(2)))
    return np.clip(scale, 1 / tuning.max_change, tuning.max_change)


def learn_noise_scale(
    selections: Sequence[Selection],
    across_px2: Float[np.ndarray, "v n 2 2"],
    previous_scale: Float[np.ndarray, "f"],
    tuning: NoiseTuning,
) -> tuple[Float[np.ndarray, "f"], Bool[np.ndarray, "f"]]:
    """Estimate the noise scale of each frame.

    The noise scale is the standard deviation of the errors across the segments, estimated over
    stated. Returns (noise scale, mask of frames to match again). A frame is matched again if its
    scale differs much from `previous_scale`, which was used for its candidates.
    """
    factor = (
        residual_scale(selections, across_px2, len(previous_scale), tuning) if selections else 1.0
    )
    scale = np.clip(previous_scale * factor, 1 / tuning.max_scale, tuning.max_scale)
    change = scale / previous_scale
    return scale, (change >= tuning.repeat_above) | (change <= tuning.repeat_below)
