"""Laws of the six masks and of their combination."""

import numpy as np
import pytest
from scipy.special import ndtr

from trinoc.segments import nevatia_babu_masks
from trinoc.segments.nevatia_babu.masks import (
    combined_kernel,
    correlate_gradient,
    mask_gradient_directions,
)


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


def test_combined_kernel_gives_the_slope_of_a_ramp() -> None:
    v, u = np.mgrid[:20, :20].astype(np.float32)
    gradient = correlate_gradient(3.0 * u - 2.0 * v + 7.0, combined_kernel())
    inside = (slice(4, -4), slice(4, -4))
    assert np.allclose(gradient.u[inside], 3.0, atol=1e-4)
    assert np.allclose(gradient.v[inside], -2.0, atol=1e-4)


def test_a_blurred_step_has_a_profile_of_the_variance_of_kernel_and_blur() -> None:
    across, blur = np.arange(-15.0, 16.0), 2.0
    step = np.tile(ndtr(across / blur).astype(np.float32), (31, 1))
    profile = correlate_gradient(step, combined_kernel()).u[15]
    variance = (profile * across**2).sum() / profile.sum()
    assert np.isclose(variance, combined_kernel().variance_px2 + blur**2, rtol=1e-3)


def test_noise_gain_is_the_spread_of_the_answer_to_white_noise() -> None:
    noise = np.random.default_rng(0).normal(size=(1000, 1000)).astype(np.float32)
    gradient = correlate_gradient(noise, combined_kernel())
    assert np.isclose(gradient.u.std(), combined_kernel().noise_gain, rtol=0.01)
    assert np.isclose(gradient.v.std(), combined_kernel().noise_gain, rtol=0.01)


def test_the_gradient_leaves_the_picture_and_gives_its_squared_size() -> None:
    grey = np.random.default_rng(1).uniform(0, 255, (30, 40)).astype(np.float32)
    before = grey.copy()
    gradient = correlate_gradient(grey, combined_kernel())
    assert np.allclose(gradient.squared, gradient.u**2 + gradient.v**2, rtol=1e-5, atol=1e-4)
    assert np.array_equal(grey, before)
