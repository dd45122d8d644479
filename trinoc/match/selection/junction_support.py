"""Step 2 of the paper: if a candidate is right, its neighbour is matched at the neighbouring
position.

Two lines whose ends meet in space meet in all views; clutter hardly ever does. So a junction
adds to the log odds of both candidates, weighted by the posterior of the other one.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.candidates.table import Candidates
from trinoc.match.evidence.junction_geometry import closest_approach, log_gap_density
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import EvidenceTuning
from trinoc.match.tuning.selection import JunctionTuning
from trinoc.numerics.joins import (
    broadcast_groups,
    expand_ranges,
    group_medians,
    group_sums,
    take_groups,
)


class EndpointPairs(NamedTuple):
    """Ordered pairs of line ends that may meet at a junction, sorted by `end`.

    End 2 k is the first end of candidate k, end 2 k + 1 its second end.

    Attributes
    ----------
    end, other_end : (e,)
        The two ends.
    log_ratio : (e, k)
        Log density of the positions of both ends at a junction over that by chance, for each gap
        scale. The density of lines in space is not included.
    """

    end: Int[np.ndarray, "e"]
    other_end: Int[np.ndarray, "e"]
    log_ratio: Float[np.ndarray, "e k"]


class JunctionParameters(NamedTuple):
    """Frequency of junctions; one value for each frame of a stack.

    Attributes
    ----------
    end_at_junction : float or (f,)
        Share of line ends that meet another line end.
    gap_shares : (k,)
        Share of each scale of the gap between an end and its junction.
    """

    end_at_junction: Float[np.ndarray, "*f"] | float
    gap_shares: Float[np.ndarray, "*f k"]


def prior_junctions(
    tuning: JunctionTuning = DEFAULT.junctions, frames: tuple[int, ...] = ()
) -> JunctionParameters:
    """Return the junction parameters before the first EM step.

    `frames` is () for a single frame, (f,) for a stack of f frames.
    """
    gaps = np.array(tuning.prior_gaps)
    return JunctionParameters(
        np.full(frames, tuning.prior_junction_share), np.broadcast_to(gaps, (*frames, len(gaps)))
    )


def endpoint_pairs(
    candidates: Candidates,
    log_odds: Float[np.ndarray, "m"],
    tuning: JunctionTuning = DEFAULT.junctions,
    evidence: EvidenceTuning = DEFAULT.evidence,
) -> EndpointPairs:
    """List the pairs of close line ends, for candidates of one frame that share no segment.

    If there are too many pairs, only the candidates with the largest `log_odds` are used.
    """
    if len(candidates.index) == 0:
        return EndpointPairs(_NO_PAIRS[:, 0], _NO_PAIRS[:, 0], np.zeros((0, len(tuning.gaps_px))))
    ends = candidates.union_ends_mm.reshape(-1, 3)
    frame = candidates.frame
    frames = 1 if frame is None else int(frame.max()) + 1
    radius_mm = tuning.search_radius_px / group_medians(candidates.px_per_mm, frame, frames)
    if frame is None:
        pairs = _pairs_of_near_ends(ends, log_odds, float(radius_mm), tuning.max_meetings)
    else:
        frame_of_end = np.repeat(frame, 2)
        pairs = _pairs_of_near_ends_in_frames(ends / radius_mm[frame_of_end, None], frame_of_end)
    first, second = pairs[:, 0] // 2, pairs[:, 1] // 2
    is_separate = (first != second) & ~_share_a_segment(candidates.index, first, second)
    pairs = pairs[is_separate]
    log_ratio = _log_ratio(candidates, pairs, tuning, evidence)
    # `log_ratio` is a density per mm^3. Times the cube of the search radius it has no unit.
    radius_of_pair = radius_mm if frame is None else radius_mm[frame[pairs[:, 0] // 2]]
    meeting_log_odds = log_ratio.max(axis=1) + 3 * np.log(radius_of_pair)
    is_relevant = np.isfinite(log_ratio).all(axis=1) & (meeting_log_odds > _FAINTEST)
    pairs, log_ratio = pairs[is_relevant], log_ratio[is_relevant]
    end = np.concatenate([pairs[:, 0], pairs[:, 1]])
    order = np.argsort(end, kind="stable")
    return EndpointPairs(
        end[order],
        np.concatenate([pairs[:, 1], pairs[:, 0]])[order],
        np.concatenate([log_ratio, log_ratio])[order],
    )


# numerical: no pairs.
_NO_PAIRS = np.zeros((0, 2), dtype=np.int64)
# numerical: coordinates are clipped to this distance, in units of the search radius, so that the
# ranges of different frames are disjoint.
_FARTHEST = 1e6
# numerical: meetings with lower log odds have no effect.
_FAINTEST = -14.0


def _pairs_of_near_ends(
    ends_mm: Float[np.ndarray, "n 3"],
    log_odds: Float[np.ndarray, "m"],
    radius_mm: float,
    limit: int,
) -> Int[np.ndarray, "p 2"]:
    """Return the pairs of line ends within `radius_mm`, at most `limit` pairs.

    While there are more pairs, the less likely half of the candidates is removed. Pairs are counted
    before they are listed, to limit the memory.
    """
    rows = np.argsort(-log_odds, kind="stable")
    while True:
        end_rows = np.stack([2 * rows, 2 * rows + 1], axis=1).reshape(-1)
        tree = KDTree(ends_mm[end_rows])
        # The tree counts each pair twice, and each end with itself.
        if tree.count_neighbors(tree, radius_mm) - len(end_rows) <= 2 * limit:
            pairs = end_rows[tree.query_pairs(radius_mm, output_type="ndarray")]
            return np.sort(pairs, axis=1)
        rows = rows[: len(rows) // 2]


def _pairs_of_near_ends_in_frames(
    positions: Float[np.ndarray, "n 3"], frame: Int[np.ndarray, "n"]
) -> Int[np.ndarray, "p 2"]:
    """Return the pairs of line ends of the same frame whose positions differ by at most 1.

    The ends are sorted along one axis, which is faster than a k-d tree for small frames.
    """
    first_coordinate = np.clip(positions[:, 0], -_FARTHEST, _FARTHEST) + 3 * _FARTHEST * frame
    order = np.argsort(first_coordinate, kind="stable")
    ordered = first_coordinate[order]
    # The slack of 0.001 exceeds the rounding error along the axis.
    last = np.searchsorted(ordered, ordered + 1.001, "right")
    first, second = expand_ranges(np.arange(1, len(order) + 1), last)
    first, second = order[first], order[second]
    squared_distance = np.zeros(len(first))
    for axis in range(3):
        squared_distance += (positions[first, axis] - positions[second, axis]) ** 2
    is_near = squared_distance <= 1
    return np.stack([first[is_near], second[is_near]], axis=1)


def _share_a_segment(
    index: Int[np.ndarray, "m v"], first: Int[np.ndarray, "e"], second: Int[np.ndarray, "e"]
) -> np.ndarray:
    return ((index[first] == index[second]) & (index[first] >= 0)).any(axis=1)


def _log_ratio(
    candidates: Candidates,
    pairs: Int[np.ndarray, "e 2"],
    tuning: JunctionTuning,
    evidence: EvidenceTuning,
) -> Float[np.ndarray, "e k"]:
    step = candidates.union_ends_mm[:, 1] - candidates.union_ends_mm[:, 0]
    direction = step / np.linalg.norm(step, axis=1, keepdims=True)
    ends = candidates.union_ends_mm.reshape(-1, 3)
    m, n = pairs[:, 0] // 2, pairs[:, 1] // 2
    distance, normal, sine, gap_mm = closest_approach(
        ends[pairs[:, 0]], direction[m], ends[pairs[:, 1]], direction[n]
    )
    px_per_mm = np.stack([candidates.px_per_mm[m], candidates.px_per_mm[n]], axis=1)
    loose_share, loose_sigmas = evidence.outlier_share, evidence.outlier_sigmas
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = candidates.union_covariance_mm2.reshape(-1, 6)
        covariance_sum = covariance[pairs[:, 0]] + covariance[pairs[:, 1]]
        variance = (covariance_sum[:, [0, 3, 5]] * normal**2).sum(axis=1) + 2 * (
            covariance_sum[:, [1, 2, 4]] * normal[:, [0, 0, 1]] * normal[:, [1, 2, 2]]
        ).sum(axis=1)
        chi = distance**2 / variance
        log_distance = -0.5 * np.log(2 * np.pi * variance) + np.log(
            (1 - loose_share) * np.exp(-chi / 2)
            + loose_share / loose_sigmas * np.exp(-chi / (2 * loose_sigmas**2))
        )
        log_gaps = log_gap_density(gap_mm * px_per_mm, px_per_mm, np.array(tuning.gaps_px))
        log_ratio = log_distance[:, None] + log_gaps - np.log(sine)[:, None]
    log_ratio[sine < tuning.smallest_sine] = -np.inf
    return log_ratio


def junction_log_odds(
    graph: EndpointPairs,
    posterior: Float[np.ndarray, "m"],
    log_ends_density: Float[np.ndarray, "*f"] | float,
    parameters: JunctionParameters,
    tuning: JunctionTuning = DEFAULT.junctions,
    frame: Int[np.ndarray, "m"] | None = None,
) -> tuple[Float[np.ndarray, "m"], JunctionParameters]:
    """Return the log odds that junctions add to each candidate, (m,), and updated parameters.

    `posterior` is the current probability of each candidate. `log_ends_density` is the log of the
    number of line ends per mm^3.
    """
    ends, frame_of_end = 2 * len(posterior), None if frame is None else np.repeat(frame, 2)
    frame_of_edge = take_groups(frame_of_end, graph.other_end)
    frames = np.size(parameters.end_at_junction)
    density = np.expand_dims(broadcast_groups(log_ends_density, frame_of_edge), -1)
    support_terms = np.exp(np.clip(graph.log_ratio - density, -50, 50))
    support_terms *= (
        broadcast_groups(parameters.gap_shares, frame_of_edge)
        * posterior[graph.other_end // 2, None]
    )
    support = np.stack(
        [
            np.bincount(graph.end, support_terms[:, k], minlength=ends)
            for k in range(support_terms.shape[1])
        ],
        axis=1,
    )
    at_junction = broadcast_groups(parameters.end_at_junction, frame_of_end)
    gain = np.log(1 - at_junction + at_junction * support.sum(axis=1))
    # Posterior share of each gap scale at each end, if its candidate is right.
    junction_share = np.expand_dims(at_junction, -1) * support / np.exp(gain)[:, None]
    weight = np.repeat(posterior, 2)
    prior, count = prior_junctions(tuning), tuning.prior_observations
    junction_weight = group_sums(weight[:, None] * junction_share, frame_of_end, frames)
    junction_weight = junction_weight + count * prior.end_at_junction * prior.gap_shares
    total_weight = junction_weight.sum(axis=-1)
    updated = JunctionParameters(
        np.clip(total_weight / (group_sums(weight, frame_of_end, frames) + count), 0.01, 0.99),
        junction_weight / np.expand_dims(total_weight, -1),
    )
    return gain.reshape(-1, 2).sum(axis=1), updated
