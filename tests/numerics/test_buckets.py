"""Lengths are rounded up, to few of them, and in finer steps where padding is work."""

from hypothesis import given, strategies as st

from trinoc.numerics import bucket, finer_bucket

COUNTS = st.integers(0, 1 << 26)


@given(COUNTS)
def test_no_length_is_too_short_and_finer_ones_waste_less(count: int) -> None:
    assert count <= finer_bucket(count) <= bucket(count)
    if count <= 1 << 16:
        assert finer_bucket(count) == bucket(count)
    else:
        assert finer_bucket(count) <= 1.25 * count
        assert finer_bucket(count) in {bucket(count) * n // 8 for n in (5, 6, 7, 8)}


@given(COUNTS, COUNTS)
def test_more_never_takes_less(one: int, other: int) -> None:
    low, high = sorted((one, other))
    assert finer_bucket(low) <= finer_bucket(high)
