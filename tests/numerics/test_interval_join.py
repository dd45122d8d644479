"""Index work: joins and tables return the same pairs as a comparison of all with all."""

import hypothesis.strategies as st
import jax
import numpy as np
from hypothesis import given

from trinoc.match.candidates.index import LAYERS, look_up_segments, search_keys, spatial_index
from trinoc.numerics.joins import (
    blocks_of_overlapping,
    expand_ranges,
    group_labels,
    overlapping,
    pairs_of_equal_keys,
)

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS, st.integers(0, 40), st.integers(0, 40))
def test_overlapping_intervals_are_those_of_a_comparison_of_all(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = np.sort(rng.random((n, 2)), axis=1), np.sort(rng.random((m, 2)), axis=1)
    i, j = overlapping(first, second)
    expected = (first[:, None, 0] < second[None, :, 1]) & (second[None, :, 0] < first[:, None, 1])
    assert sorted(zip(i.tolist(), j.tolist(), strict=True)) == [
        tuple(p) for p in np.argwhere(expected)
    ]


@given(SEEDS, st.integers(0, 40), st.integers(0, 40), st.integers(1, 60))
def test_blocks_hold_all_intervals_and_few_pairs(seed: int, n: int, m: int, at_once: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = np.sort(rng.random((n, 2)), axis=1), np.sort(rng.random((m, 2)), axis=1)
    blocks = list(blocks_of_overlapping(first, second, at_once))
    assert [row for block in blocks for row in range(block.start, block.stop)] == list(range(n))
    # One interval of `first` has m pairs at most.
    assert all(len(overlapping(first[block], second)[0]) <= at_once + m for block in blocks)


@given(st.lists(st.integers(0, 5), max_size=30), st.integers(1, 40))
def test_pairs_of_equal_keys_are_each_named_once(keys: list[int], at_once: int) -> None:
    array = np.array(keys, dtype=np.int64)
    blocks = list(pairs_of_equal_keys(array, at_once))
    # A block ends with the key that fills it.
    assert all(len(block[0]) < at_once + len(keys) for block in blocks)
    m, n = np.concatenate([np.zeros((2, 0), dtype=np.int64), *blocks], axis=1)
    pairs = {frozenset(p) for p in zip(m.tolist(), n.tolist(), strict=True)}
    expected = {frozenset((a, b)) for a in range(len(keys)) for b in range(a) if keys[a] == keys[b]}
    assert pairs == expected
    assert len(m) == len(expected)


def test_ranges_expand_with_their_owners() -> None:
    owner, position = expand_ranges(np.array([3, 7, 1]), np.array([5, 7, 2]))
    np.testing.assert_array_equal(owner, [0, 0, 2])
    np.testing.assert_array_equal(position, [3, 4, 1])


@given(SEEDS)
def test_the_table_holds_every_segment_near_a_point_and_a_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = rng.uniform(0, 200, (30, 2, 2))
    slack_rad, sigma_px = np.full(30, 0.05), 1.0
    margins = np.array([[4.0 * layer.sigmas] for layer in LAYERS]) * np.ones(30)
    table = spatial_index(ends, slack_rad, margins, np.array([200.0, 200.0]), 7.0, sigma_px)
    share = rng.random(30)
    direction = np.diff(ends, axis=1)[:, 0]
    angle = np.arctan2(direction[:, 1], direction[:, 0])
    normal = np.stack([-np.sin(angle), np.cos(angle)], axis=1)
    on = ends[:, 0] + share[:, None] * direction
    # Queries that know place and direction well or badly, and are as wrong as they say.
    layer = rng.integers(0, len(LAYERS), 30)
    uncertainty_rad = 0.99 * np.array([one.slack_rad for one in LAYERS])[layer]
    uncertainty_px = 0.99 * np.array([one.sigmas for one in LAYERS])[layer]
    point = on + rng.uniform(-4, 4, (30, 1)) * uncertainty_px[:, None] * normal
    point = np.clip(point, 0.0, 199.9)
    query_angle = angle + rng.uniform(-1, 1, 30) * (uncertainty_rad + 0.05)
    direction = np.cos(query_angle), np.sin(query_angle)
    keys = jax.vmap(
        lambda p, *uncertainties: search_keys(table.grid, [(p[0], p[1])], *uncertainties)[0]
    )(point, direction, uncertainty_rad, uncertainty_px)
    query, segment = look_up_segments(table, np.asarray(keys))
    query_pairs = set(zip(query.tolist(), segment.tolist(), strict=True))
    assert {(k, k) for k in range(30)} <= query_pairs
    assert len(query_pairs) == len(query)


@given(SEEDS, st.integers(1, 40), st.integers(0, 60))
def test_a_group_has_the_least_number_of_what_its_pairs_reach(
    seed: int, n: int, pairs: int
) -> None:
    one, other = np.random.default_rng(seed).integers(0, n, (2, pairs))
    reach = np.eye(n, dtype=int)
    reach[one, other] = reach[other, one] = 1
    reachable = np.linalg.matrix_power(reach.astype(float), n) > 0
    np.testing.assert_array_equal(group_labels(n, one, other), reachable.argmax(axis=1))
