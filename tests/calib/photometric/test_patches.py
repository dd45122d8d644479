"""Displacements of patches and their information are those of dense least squares."""

import numpy as np
import pytest

from tests.calib.photometric.pictures import RIGHT, state_at
from trinoc.calib.photometric.patches import _displacements, _shared_unknowns, _SharedUnknowns
from trinoc.calib.photometric.scene import Point
from trinoc.calib.photometric.unknowns import delivered_state


def test_shifts_and_their_information_are_those_of_all_unknowns_together() -> None:
    random = np.random.default_rng(0)
    pixels, patches = 60, 4
    patch = np.arange(pixels) % patches
    by_px, residual = random.normal(size=(2, pixels)), random.normal(size=pixels)
    weight = random.uniform(0.5, 2.0, pixels)
    shared = _SharedUnknowns(
        random.normal(size=(pixels, 3)), np.array([0.0, 4.0, 20.0]), random.normal(size=3)
    )
    shift, whitening = _displacements(by_px, patch, patches, residual, weight, shared)
    rows = np.zeros((pixels, 2 * patches))
    for axis in (0, 1):
        rows[np.arange(pixels), 2 * patch + axis] = by_px[axis]
    every = np.concatenate([rows, shared.rows], axis=1)
    normal = (every.T * weight) @ every
    normal[-3:, -3:] += np.diag(shared.prior)
    gradient = (every.T * weight) @ residual
    gradient[-3:] += shared.pull
    np.testing.assert_allclose(shift.ravel(), -np.linalg.solve(normal, gradient)[:-3])
    np.testing.assert_allclose(
        np.linalg.inv(whitening.T @ whitening), np.linalg.inv(normal)[:-3, :-3]
    )


@pytest.mark.parametrize("inflation", [1.0, 4.0])
def test_what_is_known_beforehand_counts_less_as_pixels_that_share_noise_do(inflation) -> None:
    state = delivered_state(state_at(RIGHT))
    count = state.unknowns.size
    free = np.ones(4 + count, dtype=bool)
    nothing = np.zeros(0)
    point = Point(state, free, None, 0.0, nothing, nothing, nothing)  # pyright: ignore[reportArgumentType]
    found = _shared_unknowns(point, np.eye(count), 4, inflation)
    middle, weight = state.unknowns.prior(local=False)
    assert np.asarray(weight).any()
    np.testing.assert_allclose(inflation * found.prior, weight)
    np.testing.assert_allclose(inflation * found.pull, weight * (state.values - middle))
