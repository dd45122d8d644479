"""Denoisers take noise away and leave even fields and edges of light where they are."""

import numpy as np
import pytest

from simulation.camera_picture.delivery import Bilateral, Median, NonLocalMeans, remove_noise

FILTERS = [Median(), Median(5), Bilateral(), NonLocalMeans()]


@pytest.mark.parametrize("filter_", FILTERS, ids=repr)
def test_noise_gets_less_and_the_level_stays(filter_):
    random = np.random.default_rng(0)
    noisy = 0.4 + 2 / 255 * random.normal(size=(60, 70))
    smooth = remove_noise(noisy, filter_)
    assert smooth.std() < 0.7 * noisy.std()
    assert smooth.mean() == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize("filter_", FILTERS, ids=repr)
def test_a_step_keeps_both_its_levels(filter_):
    step = np.where(np.indices((40, 40))[1] < 20, 0.1, 0.8)
    smooth = remove_noise(step, filter_)
    np.testing.assert_allclose(smooth[:, [2, -3]], step[:, [2, -3]], atol=1e-4)
    np.testing.assert_allclose(smooth[:, [18, 21]], step[:, [18, 21]], atol=1e-4)


def test_channels_are_smoothed_one_by_one():
    colour = np.random.default_rng(1).uniform(size=(20, 20, 3))
    smooth = remove_noise(colour, Median())
    np.testing.assert_array_equal(smooth[..., 1], remove_noise(colour[..., 1], Median()))
    assert remove_noise(colour, None) is colour
