"""Noise has the stated variance and correlation."""

import numpy as np
import pytest

from simulation.camera_picture.sensor import BLACK, GREY_LEVELS, Mosaic, Sensor, read_out

SHAPE = (300, 300)


@pytest.mark.parametrize("signal", [0.02, 0.3, 0.8])
def test_variance_grows_with_the_level_by_the_electrons(signal):
    sensor = Sensor(exposure=1.0, read_levels=1.5, electrons_per_level=25.0)
    picture = read_out(np.full(SHAPE, signal), sensor, seed=4) * GREY_LEVELS
    expected = 1.5**2 + signal * GREY_LEVELS / 25.0
    # The sigma of a variance is sqrt(2 / n) of it.
    assert picture.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / picture.size))
    assert sensor.noise_levels(signal) == pytest.approx(np.sqrt(expected))
    assert picture.mean() == pytest.approx(
        signal * GREY_LEVELS, abs=5 * np.sqrt(expected / picture.size)
    )


def test_smoothed_noise_keeps_its_variance_and_is_alike_in_neighbours():
    sensor = Sensor(exposure=1.0, read_levels=2.0, correlation_px=1.2)
    noise = read_out(np.full(SHAPE, 0.5), sensor, seed=5) * GREY_LEVELS - 0.5 * GREY_LEVELS
    # As many independent values as circles of correlation.
    independent = noise.size / (4 * np.pi * 1.2**2)
    assert noise.var() == pytest.approx(4.0, rel=5 * np.sqrt(2 / independent))
    for lag in (1, 2, 3):
        alike = np.mean(noise[:, lag:] * noise[:, :-lag]) / noise.var()
        expected = np.exp(-(lag**2) / (4 * 1.2**2))
        assert alike == pytest.approx(expected, abs=5 / np.sqrt(independent))


def test_the_signal_stops_at_saturation_and_below_black():
    field = np.array([[-1.0, 0.0, 0.4, 3.0]])
    signal = read_out(field, Sensor(exposure=1.0, read_levels=0.0), seed=0)
    np.testing.assert_allclose(signal, [[-BLACK, 0.0, 0.4, 1.0]])


def test_a_mosaic_begins_with_red_and_green_over_green_and_blue():
    sensor = Sensor(exposure=1.0, read_levels=0.0, mosaic=Mosaic((0.5, 1.0, 0.25)))
    signal = read_out(np.full((4, 4), 0.8), sensor, seed=0)
    tile = np.array([[0.4, 0.8], [0.8, 0.2]])
    np.testing.assert_allclose(signal, np.tile(tile, (2, 2)))


def test_noise_repeats_by_seed():
    sensor = Sensor(electrons_per_level=10.0)
    first, repeated, other = (read_out(np.full((8, 8), 0.5), sensor, seed=s) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, repeated)
    assert not np.array_equal(first, other)
