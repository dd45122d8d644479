"""The weight of a robust loss is its derivative, and its scale has the stated meaning."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

from trinoc.numerics.robust_loss import (
    AbstractRobustLoss,
    GemanMcClure,
    ScaleMixture,
)

BOUNDED = [GemanMcClure.from_scale(3.0)]
MIXTURE = ScaleMixture((0.84, 0.12, 0.04), (1.0, 2.0, 5.0), 2)
LOSSES = [*BOUNDED, MIXTURE]
SQUARED = np.linspace(0.0, 200.0, 50)


@pytest.mark.parametrize("loss", LOSSES)
def test_the_weight_is_the_derivative_and_the_square_of_its_root(loss: AbstractRobustLoss) -> None:
    np.testing.assert_allclose(jax.vmap(jax.grad(loss.rho))(SQUARED), loss.weight(SQUARED))
    np.testing.assert_allclose(loss.root_weight(SQUARED) ** 2, loss.weight(SQUARED))


@pytest.mark.parametrize("loss", BOUNDED)
def test_small_residuals_count_in_full_and_large_ones_reach_the_ceiling(loss: GemanMcClure) -> None:
    assert float(jax.grad(loss.rho)(jnp.zeros(()))) == 1
    assert (np.diff(loss.rho(SQUARED)) > 0).all()
    assert (np.asarray(loss.rho(SQUARED)) < loss.ceiling).all()
    assert float(loss.rho(np.asarray(1e12))) == pytest.approx(float(loss.ceiling))


@pytest.mark.parametrize("loss", BOUNDED)
def test_a_wider_loss_is_the_same_in_another_unit(loss: GemanMcClure) -> None:
    np.testing.assert_allclose(
        loss.widen(5.0).rho(25.0 * SQUARED), 25.0 * np.asarray(loss.rho(SQUARED))
    )


def test_an_infinite_scale_is_plain_least_squares() -> None:
    plain = GemanMcClure.from_scale(np.inf)
    np.testing.assert_array_equal(plain.rho(SQUARED), SQUARED)
    np.testing.assert_array_equal(plain.weight(SQUARED), 1.0)


def test_a_mixture_is_minus_twice_the_log_likelihood_of_errors_of_several_sizes() -> None:
    errors = np.random.default_rng(0).normal(scale=4.0, size=(30, 2))
    density = sum(
        share * norm.pdf(errors, scale=scale).prod(axis=1)
        for share, scale in zip(MIXTURE.shares, MIXTURE.scales, strict=True)
    )
    squared = (errors**2).sum(axis=1)
    np.testing.assert_allclose(MIXTURE.log_density(squared), np.log(density))
    none = MIXTURE.log_density(np.zeros(1))
    np.testing.assert_allclose(MIXTURE.rho(squared), -2 * (np.log(density) - none))


def test_far_out_the_widest_errors_of_a_mixture_are_left() -> None:
    far = np.array([1e4, 1e6, 1e8])
    np.testing.assert_allclose(MIXTURE.weight(far), 1 / 25)
    np.testing.assert_allclose(np.diff(MIXTURE.rho(far)), np.diff(far) / 25)
