"""Factors on claimed sigmas are those of the residuals, and 1 where these are too few to tell."""

import numpy as np
import pytest

from trinoc.calib.bundle.variance_components import segment_factor


@pytest.mark.parametrize("factor", [0.3, 1.0, 2.5])
def test_the_factor_is_that_by_which_residuals_exceed_what_they_claim(factor: float) -> None:
    tracks, views = 400, 4
    squared = factor**2 * np.random.default_rng(2).chisquare(2, (tracks, views))
    # Each track's line takes four of the eight distances.
    found, inlier = segment_factor(squared / 2, np.ones((tracks, views), dtype=bool), 0.0)
    assert found == pytest.approx(factor, rel=0.05)
    assert inlier.all()


def test_too_few_residuals_leave_the_claimed_sigmas() -> None:
    nothing, pairs = np.zeros((5, 3)), np.array([[True, True, False]] * 5)
    # What rounding leaves of a trace that is zero must not pass for a degree of freedom.
    for trace in (0.0, -1e-12, 3.0):
        assert segment_factor(nothing, pairs, trace)[0] == 1.0
