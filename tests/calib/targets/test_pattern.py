"""Laws of all constructors of the sheet, and codes that identify a position."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trinoc.calib.targets.pattern import LINE_STYLES, Pattern
from trinoc.calib.targets.ring_code import conflicts, is_ambiguous, ring_code
from trinoc.errors import InputError

GRIDS = st.tuples(st.integers(2, 9), st.integers(2, 9))


@given(grid=GRIDS, pitch_mm=st.floats(5, 60), share=st.floats(0.1, 0.45))
def test_cross_grid_is_centred_and_ordered_as_it_is_read(grid, pitch_mm, share):
    rows, columns = grid
    pattern = Pattern.cross_grid(
        rows=rows, columns=columns, pitch_mm=pitch_mm, radius_mm=share * pitch_mm, rings="none"
    )
    assert len(pattern) == rows * columns
    np.testing.assert_allclose(pattern.centres_mm.mean(axis=0), 0.0, atol=1e-9 * pitch_mm)
    table = pattern.centres_mm.reshape(rows, columns, 2)
    np.testing.assert_allclose(np.diff(table[..., 0], axis=1), pitch_mm)
    np.testing.assert_allclose(np.diff(table[..., 1], axis=0), -pitch_mm)


@given(grid=st.tuples(st.integers(1, 4), st.integers(1, 4)))
def test_lines_of_even_grids_touch_no_circle(grid):
    rows, columns = (2 * half for half in grid)
    pattern = Pattern.cross_grid(rows=rows, columns=columns, pitch_mm=20, radius_mm=6, rings="none")
    clear_mm = np.abs(pattern.centres_mm) - pattern.radius_mm[:, None]
    assert np.all(clear_mm > pattern.line_width_mm)


def test_default_sheet_fits_paper_and_crosses_at_the_origin():
    pattern = Pattern.default()
    assert len(pattern) == 64
    assert np.all(np.abs(pattern.centres_mm) + 6.0 < 85.0)
    assert max(pattern.line_half_length_mm) * 2 < 210.0 - 2 * 15.0
    assert 0.3 < pattern.is_ring.mean() < 0.7


@pytest.mark.parametrize("grid", [(3, 3), (3, 5), (4, 4), (5, 5), (6, 4), (8, 8), (9, 7)])
def test_codes_tell_all_turns_and_the_mirror_apart(grid):
    code = ring_code(*grid)
    assert code.shape == grid
    assert not is_ambiguous(code)
    np.testing.assert_array_equal(code, ring_code(*grid))


def test_a_block_of_the_default_sheet_names_its_place():
    code = ring_code(8, 8)
    assert conflicts(code, (3, 4), 1) == 0
    assert conflicts(code, (4, 4), 3) == 0


def test_conflicts_counts_what_it_says():
    striped = np.zeros((3, 6), dtype=bool)
    striped[:, ::2] = True
    assert conflicts(striped, (3, 4), 1) > 0
    lone = np.zeros((3, 3), dtype=bool)
    lone[0, 1] = lone[0, 0] = True
    assert conflicts(lone, (3, 3), 1) == 0
    assert conflicts(np.zeros((3, 3), dtype=bool), (3, 3), 1) == 7


def test_asymmetric_grid_is_that_of_opencv():
    pattern = Pattern.asymmetric_circle_grid(rows=11, columns=4, spacing_mm=20, radius_mm=5)
    row, column = np.divmod(np.arange(44), 4)
    opencv = np.stack([(2 * column + row % 2) * 20.0, row * 20.0], axis=1)
    across = (pattern.centres_mm - pattern.centres_mm[0]) * np.array([1.0, -1.0])
    np.testing.assert_allclose(across, opencv, atol=1e-12)


@given(grid=GRIDS, asymmetric=st.booleans())
def test_lattice_neighbours_are_the_nearest_circles(grid, asymmetric):
    rows, columns = grid
    if asymmetric:
        pattern = Pattern.asymmetric_circle_grid(
            rows=rows, columns=columns, spacing_mm=20, radius_mm=5
        )
    else:
        pattern = Pattern.circle_grid(rows=rows, columns=columns, pitch_mm=20, radius_mm=5)
    lattice_distance = np.abs(pattern.lattice[:, None] - pattern.lattice[None]).sum(axis=2)
    distance = np.linalg.norm(pattern.centres_mm[:, None] - pattern.centres_mm[None], axis=2)
    nearest = np.min(distance[lattice_distance > 0])
    np.testing.assert_allclose(distance[lattice_distance == 1], nearest)


@given(x=st.floats(0.99, 1.01), y=st.floats(0.99, 1.01))
def test_rescaling_back_gives_the_sheet_again(x, y):
    pattern = Pattern.default()
    back = pattern.rescale(x, y).rescale(1 / x, 1 / y)
    np.testing.assert_allclose(back.centres_mm, pattern.centres_mm, rtol=1e-12)
    np.testing.assert_allclose(back.radius_mm, pattern.radius_mm, rtol=1e-12)
    np.testing.assert_allclose(
        pattern.rescale(x, y).centres_mm, pattern.centres_mm * np.array([x, y])
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius_mm": 11.0}, "overlap"),
        ({"radius_mm": -1.0}, "not positive"),
        ({"inner_radius_mm": 6.0}, "hole"),
        ({"line_style": "dotted"}, "line style"),
        ({"line_width_mm": -1.0}, "negative"),
        ({"pitch_mm": float("nan")}, "finite"),
        ({"rows": 0}, "empty"),
        ({"rings": np.zeros((2, 2), dtype=bool)}, "shape"),
    ],
)
def test_sheets_that_cannot_be_are_refused_in_a_sentence(changes, message):
    fields = {"rows": 4, "columns": 4, "pitch_mm": 20.0, "radius_mm": 6.0}
    with pytest.raises(InputError, match=message):
        Pattern.cross_grid(**(fields | changes))


def test_line_styles_are_the_three_documented():
    for style in LINE_STYLES:
        assert (
            Pattern.cross_grid(
                rows=5, columns=5, pitch_mm=20, radius_mm=6, line_style=style
            ).line_style
            == style
        )
