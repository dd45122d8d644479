"""Sharpening, rounding, JPEG."""

import numpy as np
import pytest

from simulation.camera_picture.delivery import (
    SRGB,
    Processing,
    Sharpening,
    deliver_picture,
    jpeg,
    quantise,
    sharpen,
)


def waves(frequency, size=128):
    return 0.5 + 0.2 * np.cos(2 * np.pi * frequency * np.arange(size))[None, :] * np.ones((40, 1))


def test_sharpening_lifts_a_wave_by_what_the_gaussian_takes():
    radius, amount, frequency = 1.2, 0.7, 0.125
    lifted = sharpen(waves(frequency), Sharpening(radius, amount))[20, 32:-32]
    passed = np.exp(-2 * (np.pi * radius * frequency) ** 2)
    expected = 0.5 + (waves(frequency)[20, 32:-32] - 0.5) * (1 + amount * (1 - passed))
    # OpenCV samples its Gaussian at whole pixels and cuts it off.
    np.testing.assert_allclose(lifted, expected, atol=1e-3)


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), (10, np.uint16), (16, np.uint16)])
def test_bits_round_to_half_a_step(bits, dtype):
    grey = np.random.default_rng(0).uniform(size=(20, 20))
    picture = quantise(grey, bits)
    assert picture.dtype == dtype
    assert np.abs(picture / (2**bits - 1) - grey).max() <= 0.5 / (2**bits - 1) + 1e-12
    assert quantise(np.array([[-0.2, 1.3]]), bits).tolist() == [[0, 2**bits - 1]]


def test_jpeg_loses_more_at_less_quality_and_keeps_colours_apart():
    random = np.random.default_rng(1)
    picture = (80 + 20 * random.normal(size=(64, 64))).astype(np.uint8)
    loss = [np.abs(jpeg(picture, q).astype(int) - picture).mean() for q in (30, 60, 95)]
    assert loss[0] > loss[1] > loss[2] > 0
    red = np.zeros((32, 32, 3), dtype=np.uint8)
    red[..., 0] = 200
    np.testing.assert_allclose(jpeg(red, 95).astype(int), red, atol=4)


def test_processing_runs_in_its_order():
    signal = np.array([[-0.05, 0.0, 0.2, 1.0]]) * np.ones((4, 1))
    picture = deliver_picture(signal, None, Processing(response=SRGB()))
    expected = np.rint(255 * SRGB().encode(np.array([0.0, 0.0, 0.2, 1.0])))
    np.testing.assert_array_equal(picture[0], expected)
