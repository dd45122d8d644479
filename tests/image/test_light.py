"""A picture as light: one scale, colours, noise and clipped pixels."""

import numpy as np
import pytest

from simulation.camera_picture.delivery import SRGB
from trinoc.image.light import Light
from trinoc.image.response import PowerResponse

RANDOM = np.random.default_rng(2)
COLOUR = RANDOM.integers(0, 256, (20, 30, 3)).astype(np.uint8)


def test_light_of_a_colour_is_the_mean_of_its_channels() -> None:
    light = Light.from_picture(COLOUR, "srgb").light
    curve = np.linspace(0, 1, 4001)
    expected = 255 * np.interp(COLOUR / 255, SRGB().encode(curve), curve).mean(axis=2)
    np.testing.assert_allclose(light, expected, atol=0.5)
    np.testing.assert_allclose(light, Light.from_picture(COLOUR / 255.0, "srgb").light, atol=1e-3)
    np.testing.assert_array_equal(light, Light.from_picture(COLOUR[..., ::-1], "srgb").light)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_light_and_white_are_in_255ths_whatever_the_depth(bits: int) -> None:
    full = 2**bits - 1
    levels = np.rint(np.linspace(0, full, 40 * 50)).reshape(40, 50)
    picture = levels.astype(np.uint8 if bits == 8 else np.uint16)
    light = Light.from_picture(picture, 1.0)
    assert light.size_px == (50, 40)
    np.testing.assert_allclose(light.levels, levels * (255 / full), atol=1e-4)
    expected = 255 * np.asarray(PowerResponse(1.0).light_of(levels / full))
    np.testing.assert_allclose(light.light, expected, atol=1e-3)
    assert light.light_of_white == pytest.approx(
        float(255 * PowerResponse(1.0).light_of(254 / 255)), rel=1e-6
    )
    assert light.quantum == pytest.approx(255 / full)


def test_light_of_a_linear_camera_is_its_levels() -> None:
    light = Light.from_picture(COLOUR)
    assert light.is_linear
    assert light.light is light.levels
    assert light.light_of_white == light.white


@pytest.mark.parametrize("noise", [0.0, 0.8, 3.0])
def test_noise_is_that_of_the_light_and_never_less_than_rounding(noise: float) -> None:
    flat = 120 + RANDOM.normal(0, 1, (200, 200)) * noise
    levels = np.clip(np.rint(flat), 0, 255).astype(np.uint8)
    linear, srgb = Light.from_picture(levels), Light.from_picture(levels, "srgb")
    rounding = np.sqrt(1 / 12)
    expected = rounding if noise == 0 else np.hypot(noise, rounding)
    assert linear.noise_sigma() == pytest.approx(expected, rel=0.03)
    if noise > 1:
        # Light changes by what the curve makes of a level.
        slope = float(PowerResponse(1.0).slope_at(srgb.light.mean() / 255))
        assert srgb.noise_sigma() == pytest.approx(expected / slope, rel=0.05)


def test_clipped_pixels_and_their_neighbours() -> None:
    picture = np.full((40, 40), 100, np.uint8)
    picture[10, 20] = 255
    light = Light.from_picture(picture)
    assert light.find_clipped().sum() == 1
    near_clipped = light.find_clipped(2)
    assert near_clipped.sum() == 25
    assert near_clipped[8:13, 18:23].all()
