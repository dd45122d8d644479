"""The picture for a screen: sizes are true to a small part of a pixel."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io import read_image, save_pattern_png
from trinoc.io.pattern_page import drawing_size_mm
from trinoc.io.pattern_png import pattern_picture

SHEET = Pattern.cross_grid(rows=4, columns=4, pitch_mm=20.0, radius_mm=6.0)


def ink_of(picture: np.ndarray) -> np.ndarray:
    """Fraction of ink in each pixel, computed from its linear light."""
    level = picture / 255.0
    return 1.0 - np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)


@settings(max_examples=8)
@given(pitch_mm=st.floats(0.3, 0.7), odd=st.integers(0, 1))
def test_circles_stand_where_the_pattern_says(pitch_mm, odd):
    width, height = int(103 / pitch_mm) + odd, int(101 / pitch_mm)
    ink = ink_of(pattern_picture(SHEET, size_px=(width, height), pitch_mm=pitch_mm))
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y = (u - (width - 1) / 2) * pitch_mm, ((height - 1) / 2 - v) * pitch_mm
    for centre, inner in zip(SHEET.centres_mm, SHEET.inner_radius_mm, strict=True):
        is_near = np.hypot(x - centre[0], y - centre[1]) < 8.0
        mass = ink[is_near].sum()
        centroid = np.array([ink[is_near] @ x[is_near], ink[is_near] @ y[is_near]]) / mass
        # Lattice points and 256 levels: a hundredth of a pixel, and .3 % of the area.
        np.testing.assert_allclose(centroid, centre, rtol=0, atol=0.01 * pitch_mm)
        assert mass * pitch_mm**2 == pytest.approx(np.pi * (36.0 - inner**2), rel=3e-3)


@pytest.mark.parametrize(
    "board",
    [
        Chessboard(rows=3, columns=4, square_mm=10.0),
        Charuco(rows=4, columns=5, square_mm=10.0, marker_mm=7.5),
        Pattern.cross_grid(rows=3, columns=3, pitch_mm=20.0, radius_mm=6.0, line_style="white"),
    ],
    ids=lambda board: board.name,
)
def test_pixels_that_divide_finer_show_the_same_ink(board):
    coarse = ink_of(pattern_picture(board, size_px=(180, 160), pitch_mm=0.5))
    fine = ink_of(pattern_picture(board, size_px=(360, 320), pitch_mm=0.25))
    mean = fine.reshape(160, 2, 180, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse, mean, atol=0.02)
    columns, rows = coarse.max(axis=0) > 0.01, coarse.max(axis=1) > 0.01
    extent = np.array([columns.sum(), rows.sum()]) * 0.5
    np.testing.assert_allclose(extent, drawing_size_mm(board), atol=1.0)


def test_a_screen_that_is_too_small_is_named_with_its_size(tmp_path):
    path = tmp_path / "sheet.png"
    with pytest.raises(InputError, match="the screen is 80 x 60 mm"):
        save_pattern_png(SHEET, path, size_px=(320, 240), pitch_mm=0.25)
    assert not path.exists()
    save_pattern_png(SHEET, path, size_px=(410, 402), pitch_mm=0.25)
    assert read_image(path).shape[:2] == (402, 410)
