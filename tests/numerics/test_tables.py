"""Laws of tables, tested on every table class."""

import dataclasses
import re

import numpy as np
import pytest
from hypothesis import given, strategies as st

import trinoc
from tests.io.formats.bench import bench_matches
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.geometry import Junctions
from trinoc.geometry.segments import Segments
from trinoc.io.frames_table import Frames
from trinoc.io.tables_npz import ArrayFields, build_table, list_arrays
from trinoc.match.features import FEATURES
from trinoc.match.tracks.matches import Matches
from trinoc.match.wire_frame.frame import LetGo
from trinoc.numerics.tables import Table, is_covariance, list_fields

KINDS = [Segments, Junctions, Matches, LetGo, Frames, *FEATURES]
SEGMENTS = Segments.from_endpoints(np.random.default_rng(5).uniform(0, 400, (6, 4)))
MATCHES = bench_matches(5).with_marks(
    share=np.linspace(0, 1, 5), word=np.array(["a", "bc", "", "d", "e"])
)
TABLES: list[Table] = [SEGMENTS, MATCHES, made_rims(), made_wireframe()]


@pytest.mark.parametrize("kind", KINDS)
def test_every_field_has_its_sentence(kind: type[Table]) -> None:
    listed = re.findall(r"^\s*(?:.*\. )?((?:\w+, )*\w+) : ", kind.__doc__ or "", re.MULTILINE)
    named = {name for line in listed for name in line.split(", ")}
    inner = set(re.findall(r"\b(\w+) : \(", kind.__doc__ or ""))
    assert {field.name for field in list_fields(kind)} <= named | inner


@pytest.mark.parametrize("table", TABLES, ids=lambda table: type(table).__name__)
def test_what_is_written_is_what_is_read(table: Table) -> None:
    fields = ArrayFields(list_arrays(table), "file")
    back = build_table(type(table), fields)
    for name, array in list_arrays(back).items():
        np.testing.assert_array_equal(array, list_arrays(table)[name])


@pytest.mark.parametrize("kind", KINDS)
def test_sides_with_a_name_have_words(kind: type[Table]) -> None:
    for field in list_fields(kind):
        named_sides = {side for side in field.sides if not side.isdigit()}
        assert named_sides <= set(kind.SIDES)


@given(st.lists(st.integers(0, 4), max_size=6))
def test_rows_are_taken_and_appended(rows: list[int]) -> None:
    selected = np.array(rows, dtype=np.int64)
    part = MATCHES.take(selected)
    for name, column in part.named_columns().items():
        np.testing.assert_array_equal(column, MATCHES.named_columns()[name][selected])
    part_columns = {name: v for name, v in part.rows().items() if name != "marks"}
    longer = MATCHES.append(part_columns | {"share": part.marks["share"]})
    np.testing.assert_array_equal(longer.take(np.arange(5)).lines_mm, MATCHES.lines_mm)
    np.testing.assert_array_equal(longer.lines_mm[5:], part.lines_mm)
    np.testing.assert_array_equal(longer.marks["share"][5:], part.marks["share"])
    assert longer.marks["word"][5:].tolist() == [""] * len(rows)


def test_columns_name_every_number_once() -> None:
    columns = MATCHES.named_columns()
    covariance = [name for name in columns if name.startswith("cov_")]
    assert len(covariance) == 21
    np.testing.assert_array_equal(columns["cov_y1_z2_mm2"], MATCHES.covariance_mm2[:, 1, 5])
    np.testing.assert_array_equal(columns["z2_mm"], MATCHES.lines_mm[:, 1, 2])
    view = MATCHES.views[1]
    np.testing.assert_array_equal(columns[f"{view}_v2_px"], MATCHES.fragments_px[:, 1, 1, 1])
    assert not set(covariance) & set(MATCHES.named_columns(brief=True))


def test_files_of_before_still_load() -> None:
    # A size that was not known was an empty array, and marks have always stood beside the columns.
    arrays = list_arrays(SEGMENTS) | {"image_size_px": np.array([], dtype=np.int64)}
    assert build_table(Segments, ArrayFields(arrays, "file")).image_size_px is None
    arrays = list_arrays(MATCHES) | {"measure": MATCHES.index >= 0}
    matches = build_table(Matches, ArrayFields(arrays, "file"))
    np.testing.assert_array_equal(matches.marks["measure"], MATCHES.index >= 0)


@pytest.mark.parametrize(
    "mark",
    [
        np.full(5, 1.5),
        np.full(5, -0.1),
        np.full(5, np.nan),
        np.ones(4, dtype=bool),
        np.arange(5),
        np.ones((5, len(MATCHES.views)), dtype=bool),
    ],
)
def test_a_mark_is_a_truth_value_a_probability_or_a_word(mark: np.ndarray) -> None:
    unseen = dataclasses.replace(MATCHES, index=np.where(MATCHES.index < 0, -1, MATCHES.index))
    arrays = list_arrays(unseen) | {"mark": mark}
    if mark.shape == MATCHES.index.shape and (MATCHES.index >= 0).all():
        pytest.skip("every view sees every line")
    with pytest.raises(trinoc.errors.InputError, match="truth values, probabilities or words"):
        build_table(Matches, ArrayFields(arrays, "file"))


@given(st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_covariances_are_told_from_other_matrices(size: int, seed: int) -> None:
    root = np.random.default_rng(seed).normal(size=(3, size, size))
    covariance = root @ root.swapaxes(1, 2)
    assert is_covariance(covariance).all()
    assert not is_covariance(-covariance - 1e-6 * np.eye(size)).any()
    broken = covariance.copy()
    broken[1, 0, 0] = np.nan
    assert is_covariance(broken).tolist() == [True, False, True]
