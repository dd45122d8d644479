"""Laws of a camera's response: inverse, slope, ends, the known curve and the refusals."""

import jax
import numpy as np
import pytest

from simulation.camera_picture.delivery import SRGB
from trinoc.errors import InputError
from trinoc.image.response import PowerResponse, find_response

BENDS = (-1.0, -0.3, 0.0, 0.5, 1.0, 2.0)
LIGHT = np.linspace(0.0, 1.2, 121)


@pytest.mark.parametrize("bend", BENDS)
def test_light_and_level_are_inverse_and_black_and_white_stay(bend: float) -> None:
    response, light = PowerResponse(bend), LIGHT[1:]
    np.testing.assert_allclose(response.light_of(response.level_of(light)), light, atol=1e-5)
    np.testing.assert_allclose(response.level_of(np.array([0.0, 1.0])), [0.0, 1.0], atol=1e-12)


@pytest.mark.parametrize("bend", BENDS)
def test_the_slope_is_that_of_the_levels(bend: float) -> None:
    """Also below black, where levels continue along the tangent."""
    response, step = PowerResponse(bend), 1e-7
    light = np.concatenate([[-0.05, -0.002, -0.0005], LIGHT])
    below, above = (response.level_of(light + k * step) for k in (-1, 1))
    np.testing.assert_allclose(response.slope_at(light), (above - below) / (2 * step), rtol=1e-3)


def test_traced_and_plain_numbers_agree() -> None:
    with jax.enable_x64(True):
        level, light = (
            jax.jit(lambda x, bend, one=one: one(PowerResponse(bend), x))
            for one in (PowerResponse.level_of, PowerResponse.light_of)
        )
        np.testing.assert_allclose(level(LIGHT, 0.7), PowerResponse(0.7).level_of(LIGHT), 1e-12)
        np.testing.assert_allclose(light(LIGHT, 0.7), PowerResponse(0.7).light_of(LIGHT), 1e-12)


def test_the_named_curves_are_what_they_are_called() -> None:
    light = LIGHT[LIGHT <= 1]
    np.testing.assert_allclose(find_response("linear").level_of(light), light, atol=1e-12)
    assert find_response("linear").is_linear
    srgb, standard = np.asarray(find_response("srgb").level_of(light)), SRGB().encode(light)
    # Near black the standard's own curve is straight.
    np.testing.assert_allclose(srgb, standard, atol=8e-3)
    np.testing.assert_allclose(srgb[light > 0.02], standard[light > 0.02], atol=2e-3)
    assert not find_response("srgb").is_linear


def test_a_curve_of_ones_own_is_taken_as_it_is() -> None:
    response = PowerResponse(2.5)
    assert find_response(response) is response


@pytest.mark.parametrize("response", ["sRGB", "", float("nan"), 7.0])
def test_an_unknown_response_is_refused(response: str | float) -> None:
    with pytest.raises(InputError, match="response"):
        find_response(response)
