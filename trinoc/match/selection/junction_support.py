"""Step 2: if a candidate is right, its neighbour is matched at the neighbouring position.

Two lines whose ends meet in space meet in all views at once; clutter hardly ever does. So a
junction adds to the log odds of both its candidates, weighted by the posterior of the other.
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
    """Directed edges between ends (end = 2 * candidate + 0 or 1), sorted by the first.

    site, other : the ends. log_ratio : (e, k) log density of the meeting under each gap
        scale over that of clutter, apart from the density of lines in space.
    """

    site: Int[np.ndarray, "e"]
    other: Int[np.ndarray, "e"]
    log_ratio: Float[np.ndarray, "e k"]


class JunctionParameters(NamedTuple):
    """Share of ends at a junction, and of each gap scale at those; of each frame of a stack."""

    end_at_junction: Float[np.ndarray, "*f"] | float
    gap_shares: Float[np.ndarray, "*f k"]


def prior_junctions(
    tuning: JunctionTuning = DEFAULT.junctions, frames: tuple[int, ...] = ()
) -> JunctionParameters:
    """Before anything is learned; `frames` is the shape of one number of each frame."""
    gaps = np.array(tuning.prior_gaps)
    return JunctionParameters(
        np.full(frames, tuning.prior_at_junction), np.broadcast_to(gaps, (*frames, len(gaps)))
    )


def endpoint_pairs(
    candidates: Candidates,
    log_odds: Float[np.ndarray, "m"],
    tuning: JunctionTuning = DEFAULT.junctions,
    evidence: EvidenceTuning = DEFAULT.evidence,
) -> EndpointPairs:
    """All meetings of ends of candidates of one frame that have no segment in common; where these
    are too many, those of the candidates of the highest `log_odds`."""
    if len(candidates.index) == 0:
        return EndpointPairs(_NONE[:, 0], _NONE[:, 0], np.zeros((0, len(tuning.gaps_px))))
    ends = candidates.union_ends_mm.reshape(-1, 3)
    frame = candidates.frame
    frames = 1 if frame is None else int(frame.max()) + 1
    reach = tuning.reach_px / group_medians(candidates.px_per_mm, frame, frames)
    if frame is None:
        pairs = _near_ends(ends, log_odds, float(reach), tuning.most_meetings)
    else:
        own = np.repeat(frame, 2)
        pairs = _near_in_frames(ends / reach[own, None], own)
    first, second = pairs[:, 0] // 2, pairs[:, 1] // 2
    apart = (first != second) & ~_share_a_segment(candidates.index, first, second)
    pairs = pairs[apart]
    log_ratio = _log_ratio(candidates, pairs, tuning, evidence)
    # A density, per mm^3: against one end in a cube of the reach it has no unit.
    own_reach = reach if frame is None else reach[frame[pairs[:, 0] // 2]]
    odds = log_ratio.max(axis=1) + 3 * np.log(own_reach)
    near = np.isfinite(log_ratio).all(axis=1) & (odds > _FAINTEST)
    pairs, log_ratio = pairs[near], log_ratio[near]
    site = np.concatenate([pairs[:, 0], pairs[:, 1]])
    order = np.argsort(site, kind="stable")
    return EndpointPairs(
        site[order],
        np.concatenate([pairs[:, 1], pairs[:, 0]])[order],
        np.concatenate([log_ratio, log_ratio])[order],
    )


# numerical: no pairs.
_NONE = np.zeros((0, 2), dtype=np.int64)
# numerical: places are told apart as far out as this, in units of the reach: nothing that meets
# lies beyond.
_FAR = 1e6
# numerical: log odds of a meeting, below which it supports nothing.
_FAINTEST = -14.0


def _near_ends(
    ends_mm: Float[np.ndarray, "n 3"], log_odds: Float[np.ndarray, "m"], reach_mm: float, most: int
) -> Int[np.ndarray, "p 2"]:
    """Pairs of ends within reach of each other, at most so many: those of the likelier half of the
    candidates, halved until they are few enough. They are counted before they are listed."""
    rows = np.argsort(-log_odds, kind="stable")
    while True:
        own = np.stack([2 * rows, 2 * rows + 1], axis=1).reshape(-1)
        tree = KDTree(ends_mm[own])
        # Counted both ways round, and each with itself.
        if tree.count_neighbors(tree, reach_mm) - len(own) <= 2 * most:
            pairs = own[tree.query_pairs(reach_mm, output_type="ndarray")]
            return np.sort(pairs, axis=1)
        rows = rows[: len(rows) // 2]


def _near_in_frames(
    places: Float[np.ndarray, "n 3"], frame: Int[np.ndarray, "n"]
) -> Int[np.ndarray, "p 2"]:
    """Pairs of places of one frame within a distance of 1: those within it along one axis are few
    in small frames, and found sooner than by a tree."""
    along = np.clip(places[:, 0], -_FAR, _FAR) + 3 * _FAR * frame
    order = np.argsort(along, kind="stable")
    ordered = along[order]
    # What rounding takes from the reach along the axis, the slack gives back.
    last = np.searchsorted(ordered, ordered + 1.001, "right")
    first, second = expand_ranges(np.arange(1, len(order) + 1), last)
    first, second = order[first], order[second]
    square = np.zeros(len(first))
    for axis in range(3):
        square += (places[first, axis] - places[second, axis]) ** 2
    near = square <= 1
    return np.stack([first[near], second[near]], axis=1)


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
    distance, unit, sine, gap_mm = closest_approach(
        ends[pairs[:, 0]], direction[m], ends[pairs[:, 1]], direction[n]
    )
    px_per_mm = np.stack([candidates.px_per_mm[m], candidates.px_per_mm[n]], axis=1)
    loose_share, loose_sigmas = evidence.loose_share, evidence.loose_sigmas
    with np.errstate(divide="ignore", invalid="ignore"):
        covariance = candidates.union_covariance_mm2.reshape(-1, 6)
        spread = covariance[pairs[:, 0]] + covariance[pairs[:, 1]]
        variance = (spread[:, [0, 3, 5]] * unit**2).sum(axis=1) + 2 * (
            spread[:, [1, 2, 4]] * unit[:, [0, 0, 1]] * unit[:, [1, 2, 2]]
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
    """(log odds that its neighbours add to each candidate, updated junction parameters).

    `log_ends_density` is the log of ends of lines per volume.
    """
    ends, of_end = 2 * len(posterior), None if frame is None else np.repeat(frame, 2)
    of_edge = take_groups(of_end, graph.other)
    frames = np.size(parameters.end_at_junction)
    density = np.expand_dims(broadcast_groups(log_ends_density, of_edge), -1)
    terms = np.exp(np.clip(graph.log_ratio - density, -50, 50))
    terms *= broadcast_groups(parameters.gap_shares, of_edge) * posterior[graph.other // 2, None]
    total = np.stack(
        [np.bincount(graph.site, terms[:, k], minlength=ends) for k in range(terms.shape[1])],
        axis=1,
    )
    at_junction = broadcast_groups(parameters.end_at_junction, of_end)
    gain = np.log(1 - at_junction + at_junction * total.sum(axis=1))
    # How much of each end is a junction, and at which gap, if its candidate is right.
    share = np.expand_dims(at_junction, -1) * total / np.exp(gain)[:, None]
    weight = np.repeat(posterior, 2)
    prior, count = prior_junctions(tuning), tuning.prior_observations
    seen = group_sums(weight[:, None] * share, of_end, frames)
    seen = seen + count * prior.end_at_junction * prior.gap_shares
    both = seen.sum(axis=-1)
    learned = JunctionParameters(
        np.clip(both / (group_sums(weight, of_end, frames) + count), 0.01, 0.99),
        seen / np.expand_dims(both, -1),
    )
    return gain.reshape(-1, 2).sum(axis=1), learned
