"""Densities of ends integrate to 1 and do not depend on the views or the position."""

from itertools import permutations

import jax
import numpy as np
import pytest

from trinoc.match.evidence.endpoints import END_COMPONENTS, end_evidence, end_search_radius_px
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.numerics.buckets import in_blocks

AGREEING_PX = np.array(DEFAULT.ends.agreement_px)
PAIR_PX = np.array(DEFAULT.ends.pair_px)

# Rows of the one kernel that all laws share.
LONGEST, ROWS = 240.0, 1 << 14


@jax.jit
@jax.vmap
def evidence(extent_px):
    first, second, third = ((e[0], e[1]) for e in extent_px)
    return end_evidence((first, second, third))


def logs(extent_px: np.ndarray) -> np.ndarray:
    """Log evidence of the ends of extents (n, 3, 2), (n, 2, c)."""
    return in_blocks(evidence, ROWS, extent_px)


@pytest.fixture(scope="module")
def extents() -> np.ndarray:
    low = np.random.default_rng(0).normal(0, 6, (200, 3))
    return np.stack([low, low + 90 + np.random.default_rng(1).normal(0, 6, (200, 3))], axis=2)


def test_each_component_is_a_density_over_that_of_uniform_ends() -> None:
    # The ends of two views relative to the third's, each uniform within the longest, are 1 / L^2.
    step = np.arange(-LONGEST, LONGEST + 1)
    second, third = (x.ravel() for x in np.meshgrid(step, step))
    low = np.stack([np.zeros_like(second), second, third], axis=1)
    # One view is the longest; the others' high ends do not count.
    high = low + np.array([LONGEST, 1.0, 1.0])
    total = np.exp(logs(np.stack([low, high], axis=2))[:, 0]).sum(axis=0) / LONGEST**2
    agreeing, pairs = len(AGREEING_PX), 2 * len(PAIR_PX)
    np.testing.assert_allclose(total[:agreeing], 1.0, rtol=1e-3)
    # The odd one out ends within the longest, less a few of the widest scale at the border.
    np.testing.assert_allclose(total[agreeing : agreeing + pairs], 1.0, rtol=0.02)
    assert len(total) == END_COMPONENTS == agreeing + pairs + 1


def test_no_view_comes_first(extents: np.ndarray) -> None:
    expected = logs(extents)
    for turn in permutations(range(3)):
        np.testing.assert_allclose(logs(extents[:, list(turn)]), expected, atol=1e-9)


def test_place_and_direction_of_the_line_mean_nothing(extents: np.ndarray) -> None:
    expected = logs(extents)
    np.testing.assert_allclose(logs(extents + 1234.5), expected, atol=1e-6)
    np.testing.assert_allclose(logs(-extents[..., ::-1])[:, ::-1], expected, atol=1e-9)


def test_the_component_that_made_the_ends_is_the_likeliest() -> None:
    # All agree; the third stops short; the third runs on; none agree.
    low = np.array([[0.0, 0.1, -0.1], [0.0, 0.1, 30.0], [0.0, 0.1, -30.0], [0.0, 30.0, -40.0]])
    kind = logs(np.stack([low, low + 100.0], axis=2))[:, 0].argmax(axis=1)
    agreeing, pairs = len(AGREEING_PX), len(PAIR_PX)
    assert kind.tolist() == [0, agreeing, agreeing + pairs, END_COMPONENTS - 1]


@pytest.mark.parametrize("number", range(len(AGREEING_PX)))
def test_ends_reach_as_far_as_the_widest_scale_that_counts(number: int) -> None:
    rules = DEFAULT.scouting
    shares = np.zeros(END_COMPONENTS)
    shares[[0, number, -1]] += 0.65, 0.9 * rules.wide_ends_share, 0.25
    assert end_search_radius_px(shares, 1e3, rules) == rules.ends_sigmas * AGREEING_PX[0]
    shares[number] += 0.2
    reach_px = end_search_radius_px(shares, 1e3, rules)
    assert reach_px is not None
    assert reach_px == rules.ends_sigmas * AGREEING_PX[number]
    assert end_search_radius_px(shares, 0.9 * reach_px / rules.max_ends_share, rules) is None
