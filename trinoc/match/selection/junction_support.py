"""Step 2: if a candidate is right, its neighbour is matched at the neighbouring position.

Two lines whose ends meet in space meet in all views at once; clutter hardly ever does. So a
junction adds to the log odds of both its candidates, weighted by the posterior of the other.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.candidates import Candidates

# Ends meet when, in pixels, they lie within this of each other.
REACH_PX = 15.0
# sin of the least angle between lines that meet.
SMALLEST_ANGLE = 0.15
# How far ends stop from their junction, in pixels, and how often each.
GAPS_PX = np.array([1.0, 3.0, 8.0])
PRIOR_GAPS = np.array([0.6, 0.3, 0.1])
PRIOR_AT_JUNCTION = 0.5
# The distance of two lines agrees with their covariances, or is LOOSE_SIGMAS times larger than
# they say, in a share LOOSE_SHARE of junctions.
LOOSE_SIGMAS, LOOSE_SHARE = 3.0, 0.15


class EndpointPairs(NamedTuple):
    """Directed edges between ends (end = 2 * candidate + 0 or 1), sorted by the first.

    site, other : the ends. log_ratio : (e, k) log density of the meeting under each gap
        scale over that of clutter, apart from the density of lines in space.
    """

    site: Int[np.ndarray, "e"]
    other: Int[np.ndarray, "e"]
    log_ratio: Float[np.ndarray, "e k"]


class JunctionParameters(NamedTuple):
    """Share of ends at a junction, and of each gap scale at those."""

    end_at_junction: float
    gap_shares: Float[np.ndarray, "k"]


PRIOR_PARAMETERS = JunctionParameters(PRIOR_AT_JUNCTION, PRIOR_GAPS)


def endpoint_pairs(candidates: Candidates) -> EndpointPairs:
    """All meetings of ends of candidates that have no segment in common."""
    ends = candidates.union_ends_mm.reshape(-1, 3)
    reach = REACH_PX / float(np.median(candidates.px_per_mm)) if len(ends) else 0.0
    pairs = KDTree(ends).query_pairs(reach, output_type="ndarray") if len(ends) else _NONE
    first, second = pairs[:, 0] // 2, pairs[:, 1] // 2
    apart = (first != second) & ~_share_a_segment(candidates.index, first, second)
    pairs = pairs[apart]
    log_ratio = _log_ratio(candidates, pairs)
    near = np.isfinite(log_ratio).all(axis=1) & (log_ratio.max(axis=1) > -20)
    pairs, log_ratio = pairs[near], log_ratio[near]
    site = np.concatenate([pairs[:, 0], pairs[:, 1]])
    order = np.argsort(site, kind="stable")
    return EndpointPairs(
        site[order],
        np.concatenate([pairs[:, 1], pairs[:, 0]])[order],
        np.concatenate([log_ratio, log_ratio])[order],
    )


_NONE = np.zeros((0, 2), dtype=np.int64)


def _share_a_segment(
    index: Int[np.ndarray, "m v"], first: Int[np.ndarray, "e"], second: Int[np.ndarray, "e"]
) -> np.ndarray:
    return ((index[first] == index[second]) & (index[first] >= 0)).any(axis=1)


def _log_ratio(candidates: Candidates, pairs: Int[np.ndarray, "e 2"]) -> Float[np.ndarray, "e k"]:
    step = candidates.union_ends_mm[:, 1] - candidates.union_ends_mm[:, 0]
    direction = step / np.linalg.norm(step, axis=1, keepdims=True)
    ends = candidates.union_ends_mm.reshape(-1, 3)
    m, n = pairs[:, 0] // 2, pairs[:, 1] // 2
    apart = ends[pairs[:, 1]] - ends[pairs[:, 0]]
    normal = np.cross(direction[m], direction[n])
    sine2 = (normal**2).sum(axis=1)
    sine = np.sqrt(sine2)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (apart * normal).sum(axis=1) / sine
        gap_m = (np.cross(apart, direction[n]) * normal).sum(axis=1) / sine2
        gap_n = (np.cross(apart, direction[m]) * normal).sum(axis=1) / sine2
        unit = normal / sine[:, None]
        covariance = candidates.union_covariance_mm2.reshape(-1, 6)
        spread = covariance[pairs[:, 0]] + covariance[pairs[:, 1]]
        variance = (spread[:, [0, 3, 5]] * unit**2).sum(axis=1) + 2 * (
            spread[:, [1, 2, 4]] * unit[:, [0, 0, 1]] * unit[:, [1, 2, 2]]
        ).sum(axis=1)
        chi = distance**2 / variance
        log_distance = -0.5 * np.log(2 * np.pi * variance) + np.log(
            (1 - LOOSE_SHARE) * np.exp(-chi / 2)
            + LOOSE_SHARE / LOOSE_SIGMAS * np.exp(-chi / (2 * LOOSE_SIGMAS**2))
        )
        scale_m, scale_n = candidates.px_per_mm[m, None], candidates.px_per_mm[n, None]
        log_gaps = -0.5 * (
            (gap_m[:, None] * scale_m) ** 2 + (gap_n[:, None] * scale_n) ** 2
        ) / GAPS_PX**2 + np.log(scale_m * scale_n / (2 * np.pi * GAPS_PX**2))
        log_ratio = log_distance[:, None] + log_gaps - np.log(sine)[:, None]
    log_ratio[sine < SMALLEST_ANGLE] = -np.inf
    return log_ratio


def junction_log_odds(
    graph: EndpointPairs,
    posterior: Float[np.ndarray, "m"],
    log_ends_density: float,
    parameters: JunctionParameters,
) -> tuple[Float[np.ndarray, "m"], JunctionParameters]:
    """(log odds that its neighbours add to each candidate, updated junction parameters).

    `log_ends_density` is the log of ends of lines per volume.
    """
    ends = 2 * len(posterior)
    terms = np.exp(np.clip(graph.log_ratio - log_ends_density, -50, 50)) * parameters.gap_shares
    terms *= posterior[graph.other // 2, None]
    total = np.stack(
        [np.bincount(graph.site, terms[:, k], minlength=ends) for k in range(terms.shape[1])],
        axis=1,
    )
    end_at_junction = parameters.end_at_junction * total.sum(axis=1)
    gain = np.log(1 - parameters.end_at_junction + end_at_junction)
    # How much of each end is a junction, and at which gap, if its candidate is right.
    share = parameters.end_at_junction * total / np.exp(gain)[:, None]
    weight = np.repeat(posterior, 2)
    seen = weight @ share + 5 * PRIOR_AT_JUNCTION * PRIOR_GAPS
    learned = JunctionParameters(
        float(np.clip(seen.sum() / (weight.sum() + 5), 0.01, 0.99)), seen / seen.sum()
    )
    return gain.reshape(-1, 2).sum(axis=1), learned
