"""The share of straight lines that are flagged by chance equals the significance."""

import numpy as np
import pytest
from scipy.stats import chi2

from tests.match.scene import MadeScene
from trinoc.match.tracks.assembly import fit_lines, flag_viewpoint_dependent, typical_misfit
from trinoc.match.tuning.every_group import DEFAULT

SIGNIFICANCE = DEFAULT.tracks.significance

REPEATS = 80


@pytest.fixture(scope="module")
def fitted(exact: MadeScene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(index, ends in space, misfit) of the same lines seen many times with the stated noise."""
    rng, fits = np.random.default_rng(15), []
    for _ in range(REPEATS):
        noise = [0.3 * rng.normal(size=ends.shape) for ends in exact.inputs.ends_px]
        ends_px = [ends + n for ends, n in zip(exact.inputs.ends_px, noise, strict=True)]
        noisy_inputs = exact.inputs._replace(ends_px=ends_px)
        ends_mm, _, misfit = fit_lines(noisy_inputs, exact.true, exact.lines_mm)
        fits.append((exact.true, ends_mm, misfit))
    index, ends, misfit = (np.concatenate(column) for column in zip(*fits, strict=True))
    return index, ends, misfit


def test_straight_lines_are_flagged_as_often_as_the_significance_says(
    exact: MadeScene, fitted
) -> None:
    index, ends_mm, misfit = fitted
    flagged = flag_viewpoint_dependent(exact.inputs, index, ends_mm, misfit)
    sigma = np.sqrt(SIGNIFICANCE * (1 - SIGNIFICANCE) / len(misfit))
    assert abs(flagged.mean() - SIGNIFICANCE) < 4 * sigma
    np.testing.assert_array_equal(flagged, misfit > misfit[~flagged].max())


def test_covariances_that_are_too_small_for_all_are_made_good(exact: MadeScene, fitted) -> None:
    index, ends_mm, misfit = fitted
    np.testing.assert_allclose(typical_misfit(index, 4 * misfit), 4.0, rtol=0.15)
    flagged = flag_viewpoint_dependent(exact.inputs, index, ends_mm, 4 * misfit)
    assert abs(flagged.mean() - SIGNIFICANCE) < 0.01
    # Covariances that are too large are left so.
    assert typical_misfit(index, misfit / 4) == 1.0
    assert typical_misfit(index[:5], 100 * misfit[:5]) == 1.0


def test_more_views_have_more_degrees_of_freedom(exact: MadeScene) -> None:
    rng, index = np.random.default_rng(3), np.zeros((4000, 5), dtype=np.int64)
    five_views = exact.inputs._replace(
        ends_px=[exact.inputs.ends_px[0]] * 5,
        lines=exact.inputs.lines._replace(matrix_px=np.zeros((5, 3, 4))),
    )
    misfit = rng.chisquare(6, 4000)
    flagged = flag_viewpoint_dependent(five_views, index, np.zeros((4000, 2, 3)), misfit)
    assert abs(flagged.mean() - SIGNIFICANCE) < 4 * np.sqrt(SIGNIFICANCE / 4000)
    np.testing.assert_array_equal(
        flagged, misfit > typical_misfit(index, misfit) * chi2.isf(SIGNIFICANCE, 6)
    )
