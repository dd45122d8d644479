"""Lengths are rounded up to few values, in finer steps where padding costs time."""

import numpy as np
from hypothesis import given, strategies as st

from trinoc.numerics.buckets import bucket, pad_rows

COUNTS = st.integers(0, 1 << 26)
FINE = st.sampled_from((1 << 12, 1 << 16))


@given(COUNTS, FINE)
def test_no_length_is_too_short_and_finer_ones_waste_less(count: int, fine: int) -> None:
    length = bucket(count, finer_above=fine)
    assert count <= length <= bucket(count)
    if count <= fine:
        assert length == bucket(count)
    else:
        assert length <= 1.5 * count
        assert length in {bucket(count) * n // 4 for n in (3, 4)}


@given(COUNTS, COUNTS, FINE)
def test_more_never_takes_less(one: int, other: int, fine: int) -> None:
    low, high = sorted((one, other))
    assert bucket(low, finer_above=fine) <= bucket(high, finer_above=fine)


@given(st.integers(0, 300), st.sampled_from((1, 4, 64, 256)))
def test_the_smallest_length_is_doubled_until_it_holds_the_rows(count: int, smallest: int) -> None:
    length = bucket(count, smallest=smallest)
    assert length == smallest or length < 2 * count
    rows = np.arange(2 * count).reshape(count, 2)
    more = pad_rows(rows, length, np.array([-1, -2]))
    np.testing.assert_array_equal(more[:count], rows)
    np.testing.assert_array_equal(more[count:], np.tile([-1, -2], (length - count, 1)))
