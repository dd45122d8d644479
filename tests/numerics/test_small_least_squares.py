"""Many small problems are solved as each would be alone, and their covariances are right."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from trinoc.numerics.robust_loss import AbstractRobustLoss, GemanMcClure, ScaleMixture
from trinoc.numerics.small_least_squares import (
    NormalEquations,
    Residuals,
    gauss_newton,
    misfit_factor,
    normal_equations,
    whitening,
)

MIXTURE = ScaleMixture((0.8, 0.2), (1.0, 4.0), 2)
LOSSES = [GemanMcClure.from_scale(4.0), MIXTURE]


def linear(count=5, observations=12, numbers=2, parameters=3, seed=0):
    """Jacobian and observations of problems with the residual jacobian @ state - observed."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(count, observations, numbers, parameters))
    return jacobian, rng.normal(size=(count, observations, numbers))


def fit(jacobian, observed, loss=None, steps=1, start=None, largest=np.inf, **more):
    def residuals(state):
        return Residuals((jacobian @ state[:, None, :, None])[..., 0] - observed, jacobian, **more)

    start = np.zeros((len(jacobian), jacobian.shape[-1])) if start is None else start
    return gauss_newton(
        residuals, np.add, start, steps=steps, loss=loss, largest_step=largest
    )  # fmt: skip


def test_one_step_solves_each_linear_problem_and_its_covariance_is_the_inverse():
    jacobian, observed = linear()
    state, equations = fit(jacobian, observed)
    for slopes, values, solution, chi_square, covariance in zip(
        jacobian, observed, state, equations.chi_square, equations.covariance(), strict=True
    ):
        rows = slopes.reshape(-1, 3)
        expected, square, *_ = np.linalg.lstsq(rows, values.ravel(), rcond=None)
        np.testing.assert_allclose(solution, expected, rtol=1e-7)
        np.testing.assert_allclose(chi_square, square[0])
        np.testing.assert_allclose(covariance, np.linalg.inv(rows.T @ rows), rtol=1e-9)
    np.testing.assert_array_equal(equations.rank(), 3)


@pytest.mark.parametrize("loss", LOSSES)
def test_the_gradient_is_the_derivative_of_half_the_losses_and_of_the_prior(
    loss: AbstractRobustLoss,
) -> None:
    jacobian, observed = linear(count=2)
    precision, mean = np.array([[0.5, 2.0, 0.0]] * 2), np.array([0.3, -0.4, 0.1])
    state_0 = np.array([0.2, 0.1, -0.3])
    residual = jacobian @ state_0 - observed
    equations = normal_equations(
        Residuals(residual, jacobian, None, np.tile(state_0 - mean, (2, 1)), precision), loss
    )

    def half(state, problem):
        rows = jacobian[problem] @ state - observed[problem]
        prior = (precision[problem] * (state - mean) ** 2).sum()
        return 0.5 * (float(np.sum(loss.rho((rows**2).sum(axis=1)))) + prior)

    for problem in range(2):
        steps = 1e-6 * np.eye(3)
        slope = [half(state_0 + d, problem) - half(state_0 - d, problem) for d in steps]
        np.testing.assert_allclose(equations.gradient[problem], np.array(slope) / 2e-6, rtol=1e-6)
        squared = (residual[problem] ** 2).sum(axis=1)
        weighted = (np.asarray(loss.weight(squared)) * squared).sum()
        np.testing.assert_allclose(equations.chi_square[problem], weighted)


def test_a_prior_is_one_more_observation_of_each_parameter():
    jacobian, observed = linear(count=1, numbers=1)
    sigma, mean = np.array([0.1, 2.0, 0.5]), np.array([1.0, -1.0, 0.5])

    def residuals(state):
        residual = (jacobian @ state[:, None, :, None])[..., 0] - observed
        return Residuals(residual, jacobian, None, state - mean, sigma[None] ** -2.0)

    state, equations = gauss_newton(residuals, np.add, np.zeros((1, 3)), steps=1)
    more = np.concatenate([jacobian, np.diag(1 / sigma)[None, :, None]], axis=1)
    all_seen = np.concatenate([observed, (mean / sigma)[None, :, None]], axis=1)
    expected, as_observed = fit(more, all_seen)
    np.testing.assert_allclose(state, expected, rtol=1e-7)
    np.testing.assert_allclose(equations.covariance(), as_observed.covariance(), rtol=1e-9)
    # The prior is no observation: it has no chi-square.
    rows = (jacobian[0] @ state[0])[:, 0] - observed[0, :, 0]
    np.testing.assert_allclose(equations.chi_square, (rows**2).sum())


def test_padding_counts_for_nothing():
    jacobian, observed = linear(count=2)
    weight = np.ones((2, 12))
    weight[1, 7:] = 0.0
    state, equations = fit(jacobian, observed, MIXTURE, 6, weight=weight)
    unpadded_state, unpadded = fit(jacobian[1:, :7], observed[1:, :7], MIXTURE, 6)
    np.testing.assert_allclose(state[1], unpadded_state[0])
    np.testing.assert_allclose(equations.information[1], unpadded.information[0])
    np.testing.assert_allclose(equations.chi_square[1], unpadded.chi_square[0])


@pytest.mark.parametrize("loss", LOSSES)
def test_reweighted_steps_end_where_the_sum_of_losses_is_least(loss: AbstractRobustLoss) -> None:
    jacobian, observed = linear(count=1, observations=40, seed=3)
    observed[0, :4] += 9.0
    state, _ = fit(jacobian, observed, loss, 60)

    def cost(parameters):
        rows = jacobian[0] @ parameters - observed[0]
        return float(np.sum(loss.rho((rows**2).sum(axis=1))))

    best = minimize(cost, state[0], method="BFGS", options={"gtol": 1e-9})
    np.testing.assert_allclose(state[0], best.x, atol=1e-5)


def test_a_free_direction_stays_and_has_no_covariance_in_any_unit():
    jacobian, observed = linear(count=3, seed=1)
    for unit in (1e-6, 1.0, 1e6):
        free = jacobian.copy()
        free[1, ..., 2] = 0.5 * free[1, ..., 0]
        free[..., 2] *= unit
        state, equations = fit(free, observed, steps=3)
        np.testing.assert_array_equal(equations.rank(), [3, 2, 3])
        assert np.isnan(equations.covariance()[1]).all()
        assert np.isfinite(equations.covariance()[[0, 2]]).all()
        # The shortest step in units that scale the columns alike.
        rows = free[1].reshape(-1, 3)
        size = np.linalg.norm(rows, axis=0)
        expected = np.linalg.pinv(rows / size, rcond=1e-6) @ observed[1].ravel() / size
        np.testing.assert_allclose(state[1], expected, rtol=1e-5)


def test_a_problem_without_a_finite_model_stays_where_it_is():
    jacobian, observed = linear(count=2)
    jacobian[1, 0] = np.nan
    state, equations = fit(jacobian, observed, steps=2)
    np.testing.assert_array_equal(state[1], 0.0)
    np.testing.assert_array_equal(equations.rank(), [3, 0])
    assert np.isnan(equations.covariance()[1]).all()


def test_a_step_is_shortened_as_a_whole():
    equations = NormalEquations(
        np.stack([np.eye(2)] * 2), np.array([[3.0, -4.0], [0.1, 0.2]]), *np.zeros((2, 2, 0))
    )
    step = equations.step(np.array([np.inf, 2.0]))
    np.testing.assert_allclose(step, [[-1.5, 2.0], [-0.1, -0.2]], rtol=1e-7)


def test_whitening_makes_errors_independent():
    root = np.random.default_rng(2).normal(size=(4, 3, 3))
    covariance = root @ root.mT
    by = whitening(covariance)
    np.testing.assert_allclose(by @ covariance @ by.mT, np.tile(np.eye(3), (4, 1, 1)), atol=1e-9)


@pytest.mark.parametrize("understated", [1.0, 3.0])
def test_errors_lie_within_the_covariance_enlarged_by_the_misfit(understated: float) -> None:
    trials, observations = 4000, 20
    jacobian = np.tile(linear(count=1, observations=observations, numbers=1)[0], (trials, 1, 1, 1))
    noise = np.random.default_rng(5).normal(size=(trials, observations, 1))
    state, equations = fit(jacobian, understated * noise)
    degrees = observations - 3
    factor = misfit_factor(equations.chi_square, degrees)
    assert (factor >= 1).all()
    covariance = factor[:, None, None] * equations.covariance()
    square = np.einsum("hi,hij,hj->h", state, np.linalg.inv(covariance), state)
    within = (square < chi2.ppf(0.9, 3)).mean()
    # A factor that is never below 1 holds a little more than it says, one estimated from 17
    # degrees of freedom a little less.
    assert 0.85 < within < 0.94
    np.testing.assert_allclose(np.median(factor), understated**2, rtol=0.1)
