"""The spread of a lamp: that of the votes, and never finer than the lamps that were tried."""

from typing import cast

import numpy as np
import pytest

from trinoc.match.bodies.casting import Lamps, ShadowPairs
from trinoc.match.bodies.lamp import Votes, _mean_lamp
from trinoc.match.tuning.bodies import ShadowTuning
from trinoc.numerics.vectors import complete_axes

STEP_DEG, CHANGE = 2.0, 4e-4
TRUE, NEARNESS = np.array([0.3, -0.4, 0.866]) / np.linalg.norm([0.3, -0.4, 0.866]), 1e-2


class NormalVotes(Votes):
    """Votes whose log likelihood is that of a normal distribution about one lamp; its standard
    deviations stand for `prior`."""

    def ratios(self, lamps: Lamps, turn_deg: float, tuning: ShadowTuning) -> np.ndarray:
        off = np.column_stack([lamps.direction @ complete_axes(TRUE).T, lamps.nearness - NEARNESS])
        return ((off / self.prior) ** 2).sum(axis=1)[:, None]

    def scores(self, ratios: np.ndarray, tuning: ShadowTuning) -> np.ndarray:
        return -0.5 * ratios[:, 0]


def covariance_of(turn_rad: float, nearness: float) -> np.ndarray:
    sigma, nothing = np.array([turn_rad, turn_rad, nearness]), np.zeros(0)
    votes = NormalVotes(cast(ShadowPairs, None), sigma, nothing, 0.0)
    best = Lamps(TRUE[None], np.array([NEARNESS]))
    return _mean_lamp(votes, best, STEP_DEG, CHANGE, ShadowTuning()).covariance


def test_sure_votes_leave_the_lamp_as_unsure_as_the_grid_is_wide() -> None:
    """The last lamps tried are a quarter of a step apart in direction, half a change in nearness;
    anywhere within one such step of direction, or half of one of nearness, is as likely."""
    found = np.diag(covariance_of(1e-6, 1e-9))
    turn, change = np.radians(STEP_DEG / 4), CHANGE / 4
    np.testing.assert_allclose(found, [turn**2 / 3, turn**2 / 3, change**2 / 3], rtol=1e-6)


@pytest.mark.parametrize("wider", [1.0, 1.4])
def test_the_spread_is_that_of_the_votes_and_of_the_grid(wider: float) -> None:
    turn, change = wider * np.radians(STEP_DEG / 4), wider * CHANGE / 2
    floor = [np.radians(STEP_DEG / 4) ** 2 / 3] * 2 + [(CHANGE / 4) ** 2 / 3]
    found = covariance_of(turn, change) - np.diag(floor)
    # A grid of four steps to either side, three in nearness, holds nearly all of it.
    expected = np.array([turn**2, turn**2, change**2])
    np.testing.assert_allclose(np.diag(found), expected, rtol=0.12)
    off = found / np.sqrt(np.outer(expected, expected))
    assert np.abs(off - np.diag(np.diag(off))).max() < 0.02
