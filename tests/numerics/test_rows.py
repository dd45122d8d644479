"""Tables behave as sequences of rows and index as NumPy's arrays do."""

import copy
import pickle
from typing import Any

import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.io.formats.bench import bench_matches
from trinoc.geometry.segments import Segments
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import Table, TableRow

MATCHES = bench_matches()
SEGMENTS = Segments.from_endpoints(np.random.default_rng(1).uniform(0, 400, (len(MATCHES), 4)))
COUNT = len(MATCHES)
TABLES = pytest.mark.parametrize("table", [MATCHES, SEGMENTS], ids=["matches", "segments"])


def equal(a: Table, b: Table) -> bool:
    return all(np.array_equal(*pair, equal_nan=pair[0].dtype.kind == "f") for pair in leaves(a, b))


def leaves(*tables: Table) -> Any:
    return zip(*(map(np.asarray, jax.tree.leaves(table.rows())) for table in tables), strict=True)


@TABLES
@given(rows=st.lists(st.integers(-COUNT, COUNT - 1), max_size=9))
def test_indices_slices_and_masks_are_those_of_an_array(table: Table, rows: list[int]) -> None:
    numbers = np.arange(COUNT)
    assert equal(table[rows], table.take(numbers[rows]))
    first = slice(rows[0] if rows else None, None)
    assert equal(table[first], table.take(numbers[first]))
    mask = np.isin(numbers, rows)
    assert equal(table[mask], table.take(mask))
    assert len(table[mask]) == mask.sum()


@TABLES
def test_a_row_holds_its_part_of_each_column(table: Table) -> None:
    for number, row in enumerate(table):
        assert isinstance(row, TableRow)
        for name, column in table.rows().items():
            value = getattr(row, name)
            if not isinstance(column, dict):
                np.testing.assert_array_equal(value, column[number])
        for name in table.DERIVED:
            np.testing.assert_allclose(getattr(row, name), getattr(table, name)[number])
    assert len(list(table)) == len(table) == COUNT


@TABLES
def test_what_is_not_there_is_an_error_as_of_an_array(table: Table) -> None:
    with pytest.raises(IndexError):
        table[COUNT]
    with pytest.raises(IndexError):
        table[np.ones(COUNT + 1, bool)]
    with pytest.raises(AttributeError, match="has no colour"):
        _ = table[0].colour
    assert not len(table[:0])


@TABLES
def test_a_row_can_be_copied_and_sent(table: Table) -> None:
    row = table[2]
    for other in (copy.deepcopy(row), pickle.loads(pickle.dumps(row))):
        assert repr(other) == repr(row)


def test_marks_of_a_row_are_by_name() -> None:
    marked = MATCHES.with_marks(seen=np.arange(COUNT) % 2 == 0)
    assert [row.marks["seen"] for row in marked] == [k % 2 == 0 for k in range(COUNT)]


@TABLES
def test_values_tell_their_numbers_and_no_shapes(table: Table) -> None:
    for value in (table, table[0]):
        assert "f64[" not in repr(value)
        assert repr(value).startswith(f"<{type(table).__name__}")
    assert str(COUNT) in repr(SEGMENTS)
    sure = int((MATCHES.posterior > 0.9).sum())
    assert f"{sure} of probability over 0.9" in repr(MATCHES)
    assert isinstance(MATCHES[:2], Matches)


def test_what_is_traced_has_no_numbers_to_tell() -> None:
    representations = []

    def look(segments: Segments) -> Any:
        representations.append(repr(segments))
        return segments.endpoints_px

    jax.jit(look)(SEGMENTS)
    assert representations == ["<Segments: traced>"]
