"""The noise estimate does not depend on smooth light, straight edges or ink in the picture."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from trinoc.image.noise import noise_sigma

ROW, COLUMN = np.mgrid[:300, :400]
NOISE = np.random.default_rng(2).normal(0.0, 1.0, ROW.shape)
ANYWHERE = np.ones(ROW.shape, dtype=bool)
SLOPES = st.floats(-2.0, 2.0)


@given(SLOPES, SLOPES, SLOPES)
def test_planes_of_light_and_edges_along_the_axes_change_nothing(across, down, step):
    shown = across * COLUMN + down * ROW + 50 * step * (ROW > 120) - 9 * step * (COLUMN > 77)
    assert noise_sigma(NOISE + shown) == pytest.approx(noise_sigma(NOISE), rel=1e-9)


@pytest.mark.parametrize(("stride", "error"), [((1, 1), 0.01), ((5, 1), 0.02), ((3, 3), 0.03)])
def test_white_noise_is_found_and_scales_with_the_picture(stride, error):
    # The median of n sizes errs by 1.17 / sqrt(n), and by more where they share pixels.
    sigma = noise_sigma(NOISE, stride=stride)
    assert sigma == pytest.approx(1.0, rel=error)
    assert noise_sigma(8 * NOISE + 3, stride=stride) == pytest.approx(8 * sigma, rel=1e-9)


@pytest.mark.parametrize("noise", [0.7, 1.3, 2.0])
@pytest.mark.parametrize("quantum", [1.0, 0.25])
def test_rounding_is_noise_and_its_steps_are_smoothed(noise, quantum):
    rounded = quantum * np.rint(noise * NOISE + 120.3)
    expected = quantum * np.hypot(noise, np.sqrt(1 / 12))
    assert noise_sigma(rounded, quantum=quantum) == pytest.approx(expected, rel=0.02)


def test_whole_levels_are_known_without_being_told():
    rounded = np.rint(3.0 * NOISE)
    assert noise_sigma(rounded) == noise_sigma(rounded, quantum=1.0)
    assert noise_sigma(NOISE) == noise_sigma(NOISE, quantum=0.0)


def test_only_flat_pixels_with_flat_neighbours_count():
    flat = ROW + COLUMN > 200
    inked = np.where(flat, NOISE, 1e3 * NOISE)
    assert noise_sigma(inked, flat=flat) == noise_sigma(NOISE, flat=flat)
    assert noise_sigma(NOISE, flat=ANYWHERE) == noise_sigma(NOISE)
    assert np.isnan(noise_sigma(NOISE, flat=~ANYWHERE))
