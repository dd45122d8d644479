"""Sums and medians by group equal those of each group alone."""

import hypothesis.strategies as st
import numpy as np
from hypothesis import given

from trinoc.numerics.joins import (
    broadcast_groups,
    group_medians,
    group_sums,
    take_groups,
)

ROWS = st.lists(st.tuples(st.integers(0, 4), st.floats(-1e3, 1e3)), max_size=30)


@given(ROWS)
def test_each_group_has_its_own_sum_and_median(rows: list[tuple[int, float]]) -> None:
    group = np.array([label for label, _ in rows], dtype=np.int64)
    values = np.array([value for _, value in rows], dtype=np.float64)
    pairs = np.stack([values, values**2], axis=1)
    sums, medians = group_sums(pairs, group, 6), group_medians(values, group, 6)
    for label in range(6):
        in_group = group == label
        np.testing.assert_allclose(sums[label], pairs[in_group].sum(axis=0), atol=1e-6)
        expected = np.median(values[in_group]) if in_group.any() else np.nan
        np.testing.assert_allclose(medians[label], expected)


@given(ROWS)
def test_no_groups_are_one(rows: list[tuple[int, float]]) -> None:
    values = np.array([value for _, value in rows], dtype=np.float64)
    one = np.zeros(len(values), dtype=np.int64)
    np.testing.assert_allclose(
        group_sums(values, None, 1), group_sums(values, one, 1)[0], atol=1e-9
    )
    np.testing.assert_array_equal(group_medians(values, None, 1), group_medians(values, one, 1)[0])
    assert take_groups(None, one) is None
    assert broadcast_groups(3.0, None) == 3.0
    np.testing.assert_array_equal(
        broadcast_groups(np.array([2.0, 5.0]), take_groups(one + 1, one)), 5.0 + 0 * one
    )
