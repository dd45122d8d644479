"""Laws of the six masks and of their combination."""

import numpy as np
import pytest

from trinoc.segments import nevatia_babu_masks
from trinoc.segments.nevatia_babu import combined_kernel
from trinoc.segments.nevatia_babu.masks import gradient_of, mask_gradient_directions


def test_every_mask_answers_nothing_to_a_level_picture() -> None:
    assert np.allclose(nevatia_babu_masks().sum(axis=(1, 2)), 0)


def test_every_mask_answers_the_height_of_its_own_step() -> None:
    masks = nevatia_babu_masks()
    # A picture that is bright exactly where the mask is positive.
    assert np.allclose((masks * (masks > 0)).sum(axis=(1, 2)), 1)


@pytest.mark.parametrize("first", range(6))
def test_turning_a_mask_by_90_degrees_gives_another_mask(first: int) -> None:
    masks = nevatia_babu_masks()
    turned = np.rot90(masks[first])
    partner = masks[(first + 3) % 6]
    assert np.allclose(turned, partner) or np.allclose(turned, -partner)


def test_half_a_turn_swaps_the_polarity() -> None:
    masks = nevatia_babu_masks()
    assert np.allclose(masks[:, ::-1, ::-1], -masks)


def test_every_mask_answers_most_to_a_step_across_its_own_direction() -> None:
    masks, directions = nevatia_babu_masks(), mask_gradient_directions()
    v, u = np.mgrid[-2:3, -2:3].astype(float)
    for direction in directions:
        step = np.clip(u * direction[0] + v * direction[1] + 0.5, 0, 1)
        answers = (masks * step).sum(axis=(1, 2))
        assert np.allclose(directions[np.argmax(answers)], direction)


@pytest.mark.parametrize("smoothing", [0, 1, 2])
def test_combined_kernel_gives_the_slope_of_a_ramp(smoothing: int) -> None:
    kernel = combined_kernel(smoothing)
    size = len(kernel.u)
    v, u = np.mgrid[:size, :size].astype(float)
    ramp = 3.0 * u - 2.0 * v + 7.0
    assert np.isclose((kernel.u * ramp).sum(), 3.0)
    assert np.isclose((kernel.v * ramp).sum(), -2.0)
    assert np.isclose(kernel.u.sum(), 0)
    assert np.isclose(kernel.v.sum(), 0)


def test_each_smoothing_adds_half_a_squared_pixel() -> None:
    variances = [combined_kernel(smoothing).variance_px2 for smoothing in range(3)]
    assert np.allclose(np.diff(variances), 0.5)


def test_noise_gain_is_the_spread_of_the_answer_to_white_noise() -> None:
    kernel = combined_kernel(1)
    noise = np.random.default_rng(0).normal(size=(200_000, kernel.u.size))
    assert np.isclose((noise @ kernel.u.ravel()).std(), kernel.noise_gain, rtol=0.01)


@pytest.mark.parametrize("smoothing", [0, 1, 2])
def test_smoothing_first_is_the_same_as_one_large_kernel(smoothing: int) -> None:
    kernel = combined_kernel(smoothing)
    grey = np.random.default_rng(1).uniform(0, 255, (30, 40)).astype(np.float32)
    before = grey.copy()
    gradient = gradient_of(grey, kernel)
    size = len(kernel.u)
    windows = np.lib.stride_tricks.sliding_window_view(grey, (size, size))
    inside = (slice(size // 2, -(size // 2)), slice(size // 2, -(size // 2)))
    for found, full in ((gradient.u, kernel.u), (gradient.v, kernel.v)):
        assert np.allclose(found[inside], (windows * full).sum(axis=(2, 3)), atol=1e-3)
    assert np.allclose(gradient.squared, gradient.u**2 + gradient.v**2, rtol=1e-5, atol=1e-4)
    assert np.array_equal(grey, before)
