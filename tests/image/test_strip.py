"""Pixels beside a line: their coordinates, and their levels in a linear picture."""

import numpy as np

from trinoc.image.strip import (
    list_pixels_across,
    nearest_levels,
    take_levels,
)

RANDOM = np.random.default_rng(7)
ROW, COLUMN = np.mgrid[:50, :60]
LINEAR = (3.0 + 1.7 * COLUMN - 0.9 * ROW).astype(np.float32)


def value(uv: np.ndarray) -> np.ndarray:
    return 3.0 + 1.7 * uv[..., 0] - 0.9 * uv[..., 1]


def test_pixels_across_are_the_rows_or_columns_and_their_levels_the_pictures() -> None:
    centres = RANDOM.integers([5, 5], [55, 45], (40, 2))
    along_u = RANDOM.random(40) < 0.5
    pixels = list_pixels_across(centres, along_u, 4)
    for row, centre, by_row in zip(pixels, centres, along_u, strict=True):
        moving, still = (0, 1) if by_row else (1, 0)
        np.testing.assert_array_equal(row[:, moving], centre[moving] + np.arange(-4, 5))
        assert (row[:, still] == centre[still]).all()
    level, inside = take_levels(LINEAR, pixels)
    np.testing.assert_allclose(level, value(pixels), rtol=1e-6)
    assert inside.all()


def test_beyond_the_border_a_picture_continues_level_and_has_no_pixels() -> None:
    level, inside = take_levels(LINEAR, np.array([[-3, 10], [70, 49], [5, 6]]))
    np.testing.assert_array_equal(level, LINEAR[[10, 49, 6], [0, 59, 5]])
    np.testing.assert_array_equal(inside, [False, False, True])
    u, v = np.array([-9.0, 20.4]), np.array([10.4, 99.0])
    np.testing.assert_array_equal(nearest_levels(LINEAR, u, v), LINEAR[[10, 49], [0, 20]])
