"""Meetings of ends: equal to those of all pairs of ends, symmetric, and learned by EM."""

import numpy as np
import pytest

from trinoc.match.candidates.table import Candidates, no_candidates
from trinoc.match.selection.junction_support import (
    EndpointPairs,
    endpoint_pairs,
    junction_log_odds,
    prior_junctions,
)
from trinoc.match.tuning.every_group import DEFAULT

PRIOR_PARAMETERS = prior_junctions()
GAPS_PX = np.array(DEFAULT.junctions.gaps_px)
LOOSE_SHARE = DEFAULT.evidence.outlier_share
LOOSE_SIGMAS = DEFAULT.evidence.outlier_sigmas
PRIOR_AT_JUNCTION = DEFAULT.junctions.prior_junction_share
PRIOR_GAPS = np.array(DEFAULT.junctions.prior_gaps)
REACH_PX = DEFAULT.junctions.search_radius_px
SMALLEST_ANGLE = DEFAULT.junctions.smallest_sine

LINES = 24
SIGMA_MM = 0.2


@pytest.fixture(scope="module")
def candidates() -> Candidates:
    """Lines that start near one of eight corners; every third shares a segment with another."""
    rng = np.random.default_rng(12)
    corner = np.repeat(rng.uniform(-40, 40, (8, 3)), 3, axis=0)
    direction = rng.normal(size=(LINES, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    start = corner + rng.uniform(0, 1.5, (LINES, 1)) * direction
    start += SIGMA_MM * rng.normal(size=(LINES, 3))
    end = start + rng.uniform(10, 25, (LINES, 1)) * direction
    index = np.repeat(np.arange(LINES)[:, None], 3, axis=1)
    index[2::3, 1] = index[1::3, 1]
    root = SIGMA_MM * rng.normal(size=(LINES, 2, 3, 3))
    spread = root @ root.mT
    empty = no_candidates(3)
    return empty._replace(
        index=index,
        union_ends_mm=np.stack([start, end], axis=1),
        union_covariance_mm2=spread[..., [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]],
        px_per_mm=rng.uniform(2.0, 3.0, LINES),
    )


@pytest.fixture(scope="module")
def graph(candidates: Candidates) -> EndpointPairs:
    return endpoint_pairs(candidates, np.zeros(len(candidates.index)))


def meeting(candidates: Candidates, site: int, other: int) -> np.ndarray | None:
    """(k,) log densities of a meeting of two ends, from the feet of the common perpendicular."""
    m, n = site // 2, other // 2
    if (candidates.index[m] == candidates.index[n]).any():
        return None
    a, b = candidates.union_ends_mm.reshape(-1, 3)[[site, other]]
    step = np.diff(candidates.union_ends_mm[[m, n]], axis=1)[:, 0]
    u, v = step / np.linalg.norm(step, axis=1, keepdims=True)
    sine = np.linalg.norm(np.cross(u, v))
    if np.linalg.norm(b - a) > REACH_PX / np.median(candidates.px_per_mm) or sine < SMALLEST_ANGLE:
        return None
    gaps = np.linalg.lstsq(np.stack([u, -v], axis=1), b - a)[0]
    feet = b + gaps[1] * v - a - gaps[0] * u
    normal = np.cross(u, v) / sine
    spread = np.zeros((3, 3))
    for end in (site, other):
        xx, xy, xz, yy, yz, zz = candidates.union_covariance_mm2.reshape(-1, 6)[end]
        spread += np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    sigma = np.sqrt(normal @ spread @ normal)

    def normal_density(x: float, scale: np.ndarray | float) -> np.ndarray | float:
        return np.exp(-0.5 * (x / scale) ** 2) / (np.sqrt(2 * np.pi) * scale)

    distance = float(feet @ normal)
    across = (1 - LOOSE_SHARE) * normal_density(distance, sigma)
    across += LOOSE_SHARE * normal_density(distance, LOOSE_SIGMAS * sigma)
    along = [normal_density(g, GAPS_PX / candidates.px_per_mm[k]) for g, k in zip(gaps, (m, n))]
    with np.errstate(divide="ignore"):
        return np.log(across * along[0] * along[1] / sine)


def test_meetings_are_those_of_all_pairs_of_ends(
    candidates: Candidates, graph: EndpointPairs
) -> None:
    expected = {}
    for site in range(2 * LINES):
        for other in range(2 * LINES):
            if site // 2 != other // 2:
                log_ratio = meeting(candidates, site, other)
                if log_ratio is not None and log_ratio.max() > -20:
                    expected[site, other] = log_ratio
    graph_ratios = dict(
        zip(zip(graph.end.tolist(), graph.other_end.tolist(), strict=True), graph.log_ratio)
    )
    assert len(expected) > 20
    assert graph_ratios.keys() == expected.keys()
    for ends, log_ratio in graph_ratios.items():
        np.testing.assert_allclose(log_ratio, expected[ends], atol=1e-8)


def test_meetings_are_the_same_both_ways(graph: EndpointPairs) -> None:
    both = dict(
        zip(zip(graph.end.tolist(), graph.other_end.tolist(), strict=True), graph.log_ratio)
    )
    assert len(both) == len(graph.end)
    for (site, other), log_ratio in both.items():
        np.testing.assert_array_equal(both[other, site], log_ratio)
    assert (np.diff(graph.end) >= 0).all()


def test_which_end_comes_first_means_nothing(candidates: Candidates, graph: EndpointPairs) -> None:
    turned = candidates._replace(
        union_ends_mm=candidates.union_ends_mm[:, ::-1],
        union_covariance_mm2=candidates.union_covariance_mm2[:, ::-1],
    )
    posterior = np.full(LINES, 0.6)
    one, other = (
        junction_log_odds(pairs, posterior, -9.0, PRIOR_PARAMETERS)
        for pairs in (graph, endpoint_pairs(turned, np.zeros(len(turned.index))))
    )
    np.testing.assert_allclose(one[0], other[0], atol=1e-12)
    np.testing.assert_allclose(one[1].gap_shares, other[1].gap_shares, atol=1e-12)


def test_odds_are_those_of_a_mixture_at_each_end(graph: EndpointPairs) -> None:
    posterior = np.random.default_rng(1).uniform(0, 1, LINES)
    gain, _ = junction_log_odds(graph, posterior, -9.0, PRIOR_PARAMETERS)
    at_junction, shares = PRIOR_PARAMETERS.end_at_junction, PRIOR_PARAMETERS.gap_shares
    expected = np.zeros(LINES)
    for end in range(2 * LINES):
        density = sum(
            posterior[other // 2] * shares @ np.exp(log_ratio + 9.0)
            for site, other, log_ratio in zip(*graph, strict=True)
            if site == end
        )
        expected[end // 2] += np.log(1 - at_junction + at_junction * density)
    np.testing.assert_allclose(gain, expected, atol=1e-9)


def test_no_round_of_learning_lowers_the_likelihood(graph: EndpointPairs) -> None:
    posterior = np.random.default_rng(2).uniform(0.2, 1, LINES)
    weight = np.repeat(posterior, 2)
    parameters, log_posteriors = PRIOR_PARAMETERS, []
    for _ in range(15):
        at_junction, shares = parameters.end_at_junction, parameters.gap_shares
        terms = np.exp(graph.log_ratio + 9.0) @ shares * posterior[graph.other_end // 2]
        density = np.bincount(graph.end, terms, minlength=2 * LINES)
        # Five pseudo-ends, of which a half are at a junction, with the usual gaps.
        prior = (1 - PRIOR_AT_JUNCTION) * np.log(1 - at_junction) + PRIOR_AT_JUNCTION * (
            np.log(at_junction) + PRIOR_GAPS @ np.log(shares)
        )
        log_posteriors.append(weight @ np.log(1 - at_junction + at_junction * density) + 5 * prior)
        _, parameters = junction_log_odds(graph, posterior, -9.0, parameters)
        np.testing.assert_allclose(parameters.gap_shares.sum(), 1.0)
    assert (np.diff(log_posteriors) > -1e-9).all()
    assert log_posteriors[-1] > log_posteriors[0]


def test_nothing_meets_nothing() -> None:
    graph = endpoint_pairs(no_candidates(3), np.zeros(0))
    assert len(graph.end) == 0
    gain, _ = junction_log_odds(graph, np.zeros(0), -9.0, PRIOR_PARAMETERS)
    assert len(gain) == 0
