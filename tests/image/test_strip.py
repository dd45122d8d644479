"""Pixels beside a line: samples of a linear picture are its values, wherever they are taken."""

import cv2
import numpy as np

from trinoc.image.strip import (
    interpolate_levels,
    list_pixels_across,
    nearest_levels,
    take_levels,
)

RANDOM = np.random.default_rng(7)
ROW, COLUMN = np.mgrid[:50, :60]
LINEAR = (3.0 + 1.7 * COLUMN - 0.9 * ROW).astype(np.float32)


def value(uv: np.ndarray) -> np.ndarray:
    return 3.0 + 1.7 * uv[..., 0] - 0.9 * uv[..., 1]


def test_levels_between_pixels_are_exact_in_a_linear_picture() -> None:
    uv = RANDOM.uniform([12, 12], [47, 37], (30, 8, 2)).astype(np.float32)
    angle = RANDOM.uniform(0, 2 * np.pi, (30, 8))
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=-1).astype(np.float32)
    offset = np.array([-5.0, -1.5, 0.0, 2.0, 6.5])
    found = interpolate_levels(LINEAR, uv, normal, offset)
    at = uv[:, None] + offset[:, None, None] * normal[:, None]
    # OpenCV 4 rounds both places to a 32nd of a pixel.
    rounding = (1.7 + 0.9) / 64 if int(cv2.__version__[0]) < 5 else 0.0
    np.testing.assert_allclose(found, value(at), atol=rounding + 2e-4)


def test_pixels_across_are_the_rows_or_columns_and_their_levels_the_pictures() -> None:
    at = RANDOM.integers([5, 5], [55, 45], (40, 2))
    along_u = RANDOM.random(40) < 0.5
    pixels = list_pixels_across(at, along_u, 4)
    for one, place, by_row in zip(pixels, at, along_u, strict=True):
        moving, still = (0, 1) if by_row else (1, 0)
        np.testing.assert_array_equal(one[:, moving], place[moving] + np.arange(-4, 5))
        assert (one[:, still] == place[still]).all()
    level, inside = take_levels(LINEAR, pixels)
    np.testing.assert_allclose(level, value(pixels), rtol=1e-6)
    assert inside.all()


def test_beyond_the_border_a_picture_continues_level_and_has_no_pixels() -> None:
    level, inside = take_levels(LINEAR, np.array([[-3, 10], [70, 49], [5, 6]]))
    np.testing.assert_array_equal(level, LINEAR[[10, 49, 6], [0, 59, 5]])
    np.testing.assert_array_equal(inside, [False, False, True])
    u, v = np.array([-9.0, 20.4]), np.array([10.4, 99.0])
    np.testing.assert_array_equal(nearest_levels(LINEAR, u, v), LINEAR[[10, 49], [0, 20]])
