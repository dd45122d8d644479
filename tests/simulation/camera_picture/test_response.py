"""Responses rise from black to white, and sRGB is the standard's."""

import numpy as np
import pytest

from simulation.camera_picture.delivery import SRGB, Gamma, Linear, SCurve

RESPONSES = [Linear(), SRGB(), Gamma(2.2), SCurve(), SCurve(Linear(), 0.8)]
LEVELS = np.linspace(0.0, 1.0, 4097)


@pytest.mark.parametrize("response", RESPONSES, ids=repr)
def test_a_response_rises_from_0_to_1(response):
    encoded = response.encode(LEVELS)
    np.testing.assert_allclose(encoded[[0, -1]], [0.0, 1.0], atol=1e-12)
    assert (np.diff(encoded) > 0).all()


def test_the_standard_s_inverse_undoes_srgb():
    encoded = SRGB().encode(LEVELS)
    # IEC 61966-2-1, from grey levels to light.
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(linear, LEVELS, atol=1e-7)


def test_a_power_undoes_gamma():
    np.testing.assert_allclose(Gamma(1.8).encode(LEVELS) ** 1.8, LEVELS, atol=1e-12)


def test_an_s_curve_lifts_the_contrast_of_the_middle_alone():
    slope = np.gradient(SCurve(Linear(), 0.5).encode(LEVELS), LEVELS)
    assert slope[2048] == pytest.approx(1.25, rel=1e-3)
    assert slope[1] == pytest.approx(0.5, rel=1e-2)
