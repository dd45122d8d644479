"""Colours come back where they can be known."""

import numpy as np
import pytest

from simulation.camera_picture.delivery import demosaic
from simulation.camera_picture.sensor import Mosaic, Sensor, read_out

MOSAIC = Mosaic((0.5, 1.0, 0.7))
METHODS = ["bilinear", "edge-aware"]
# Interpolated in 16 bits, over a range that reaches below black.
STEP = 2 / 65535


@pytest.mark.parametrize("method", METHODS)
def test_an_even_grey_is_white_balanced(method):
    signal = read_out(np.full((20, 24), 0.6), Sensor(1.0, 0.0, mosaic=MOSAIC), seed=0)
    np.testing.assert_allclose(demosaic(signal, MOSAIC, method), 0.6, atol=STEP)


@pytest.mark.parametrize("method", METHODS)
def test_each_filter_fills_its_own_channel(method):
    rows, columns = np.indices((20, 24)) % 2
    for channel, site in enumerate([(0, 0), None, (1, 1)]):
        is_sampled = rows != columns if site is None else (rows == site[0]) & (columns == site[1])
        signal = np.where(is_sampled, 0.3 * MOSAIC.gains[channel], 0.0)
        colour = demosaic(signal, MOSAIC, method)[4:-4, 4:-4]
        np.testing.assert_allclose(colour[..., channel], 0.3, atol=STEP)
        others = np.delete(colour, channel, axis=2)
        np.testing.assert_allclose(others, 0.0, atol=STEP)


def test_bilinear_interpolation_keeps_a_plane():
    rows, columns = np.indices((20, 24))
    plane = 0.2 + 0.01 * rows + 0.015 * columns
    signal = read_out(plane, Sensor(1.0, 0.0, mosaic=MOSAIC), seed=0)
    colour = demosaic(signal, MOSAIC, "bilinear")[2:-2, 2:-2]
    expected = np.repeat(plane[2:-2, 2:-2, None], 3, axis=2)
    np.testing.assert_allclose(colour, expected, atol=2 * STEP)
