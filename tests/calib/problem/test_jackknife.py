"""Sigmas of fits whose shots disagree: coverage over random draws."""

import numpy as np
import pytest

from trinoc.calib.problem.information import Information
from trinoc.calib.problem.outcome import (
    blend_with_jackknife,
    enlarge_covariance,
    jackknife_covariance,
    shot_scatter,
)

SHOTS, PARAMETERS, ROWS = 15, 9, 40


def drawn(random, spread, prior=0.0):
    """Shots of a linear problem at its least squares, whose true parameters are 0.

    spread : standard deviation of what is common to one shot, in each direction of its design, over
        the noise.
    """
    rows = random.normal(size=(SHOTS, ROWS, PARAMETERS))
    noise = random.normal(size=(SHOTS, ROWS))
    noise += np.einsum("snp,sp->sn", rows, spread * random.normal(size=(SHOTS, PARAMETERS)))
    of_shot = np.einsum("snp,snq->spq", rows, rows)
    prior_information = prior * np.eye(PARAMETERS)
    covariance = np.linalg.inv(of_shot.sum(axis=0) + prior_information)
    mean = np.sqrt(prior) * random.normal(size=PARAMETERS)
    pulls = np.einsum("snp,sn->sp", rows, noise)
    # The prior's mean is off by its own error.
    step = covariance @ (pulls.sum(axis=0) + mean)
    pulls = pulls - of_shot @ step
    information = Information(
        of_shot,
        pulls,
        np.zeros((SHOTS, 6, PARAMETERS)),
        np.zeros((SHOTS, 6, 6)),
        np.arange(PARAMETERS),
        prior_information,
        PARAMETERS,
    )
    return step, covariance, information


def normalised(spread, prior=0.0, draws=400):
    """Errors over reported sigmas, root mean square by parameter: (one factor, blended)."""
    random, by_factor, blended = np.random.default_rng(0), [], []
    for _ in range(draws):
        error, covariance, information = drawn(random, spread, prior)
        factor = shot_scatter(information).variance_factor
        enlarged = enlarge_covariance(covariance, factor, information.prior)
        both = enlarged
        if factor > 1.0:
            both = blend_with_jackknife(enlarged, covariance, information, factor)
        by_factor.append(error / np.sqrt(np.diag(enlarged)))
        blended.append(error / np.sqrt(np.diag(both)))
    return tuple(np.sqrt(np.mean(np.square(each), axis=0)) for each in (by_factor, blended))


def test_sigmas_hold_in_each_direction_where_shots_disagree_in_one():
    """Such a disagreement arises if the board bends differently in each shot."""
    spread = np.zeros(PARAMETERS)
    spread[0] = 1.0
    by_factor, blended = normalised(spread)
    assert by_factor[0] > 2.0
    assert blended[0] < 1.4
    assert np.all(blended[1:] < 1.1)


def test_sigmas_hold_where_shots_disagree_in_every_direction():
    _, blended = normalised(np.full(PARAMETERS, 0.7))
    np.testing.assert_allclose(blended, 1.0, atol=0.15)


def test_what_was_known_is_not_enlarged():
    _, blended = normalised(np.full(PARAMETERS, 0.7), prior=300.0)
    np.testing.assert_allclose(blended, 1.0, atol=0.2)


def test_one_shot_left_out_changes_a_linear_fit_by_what_the_jackknife_says():
    random = np.random.default_rng(1)
    error, covariance, information = drawn(random, 0.5)
    total, by_shot = information.shot_information.sum(axis=0), information.shot_information
    # Pulls at 0, where the parameters are known to be.
    at_zero = information.gradients + by_shot @ error
    without = [
        np.linalg.solve(total - by_shot[s], at_zero.sum(axis=0) - at_zero[s]) for s in range(SHOTS)
    ]
    change = np.array(without) - error
    expected = (SHOTS - 1) / SHOTS * change.T @ change
    estimate = jackknife_covariance(covariance, information, 1.0)
    np.testing.assert_allclose(np.sqrt(np.diag(estimate)), np.sqrt(np.diag(expected)), rtol=0.1)


def test_a_camera_that_one_shot_alone_shows_has_a_finite_covariance():
    random = np.random.default_rng(2)
    _, covariance, information = drawn(random, 0.5)
    of_shot, pulls = information.shot_information.copy(), information.gradients.copy()
    of_shot[1:, 0], of_shot[1:, :, 0], pulls[:, 0] = 0.0, 0.0, 0.0
    information = information._replace(shot_information=of_shot, gradients=pulls)
    covariance = np.linalg.inv(of_shot.sum(axis=0))
    enlarged = enlarge_covariance(covariance, 4.0, information.prior)
    blended = blend_with_jackknife(enlarged, covariance, information, 4.0)
    assert np.all(np.linalg.eigvalsh(blended) > 0)
    assert blended[0, 0] == pytest.approx(enlarged[0, 0], rel=0.9)
