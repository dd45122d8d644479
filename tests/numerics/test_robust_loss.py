"""A robust loss is bounded, its weight is its derivative, and it fits what its scale says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from trinoc.numerics import AbstractRobustLoss, GemanMcClure

LOSSES = [GemanMcClure.from_scale(3.0)]
SQUARED = np.linspace(0.0, 200.0, 50)


@pytest.mark.parametrize("loss", LOSSES)
def test_the_weight_is_the_derivative_and_the_square_of_its_root(loss: AbstractRobustLoss) -> None:
    np.testing.assert_allclose(jax.vmap(jax.grad(loss.rho))(SQUARED), loss.weight(SQUARED))
    np.testing.assert_allclose(loss.root_weight(SQUARED) ** 2, loss.weight(SQUARED))


@pytest.mark.parametrize("loss", LOSSES)
def test_small_residuals_count_in_full_and_large_ones_reach_the_ceiling(
    loss: AbstractRobustLoss,
) -> None:
    assert float(jax.grad(loss.rho)(jnp.zeros(()))) == 1
    assert (np.diff(loss.rho(SQUARED)) > 0).all()
    assert (np.asarray(loss.rho(SQUARED)) < loss.ceiling).all()
    assert float(loss.rho(np.asarray(1e12))) == pytest.approx(float(loss.ceiling))


@pytest.mark.parametrize("loss", LOSSES)
def test_squares_of_bounded_residuals_are_the_loss(loss: AbstractRobustLoss) -> None:
    residual = np.sqrt(SQUARED)[:, None] * np.array([0.6, -0.8])
    bounded = np.asarray(loss.bounded(residual, SQUARED[:, None]))
    np.testing.assert_allclose(np.sum(bounded**2, axis=1), loss.rho(SQUARED))


@pytest.mark.parametrize("loss", LOSSES)
def test_a_wider_loss_is_the_same_in_another_unit(loss: AbstractRobustLoss) -> None:
    np.testing.assert_allclose(
        loss.widened(5.0).rho(25.0 * SQUARED), 25.0 * np.asarray(loss.rho(SQUARED))
    )


def test_an_infinite_scale_is_plain_least_squares() -> None:
    plain = GemanMcClure.from_scale(np.inf)
    np.testing.assert_array_equal(plain.rho(SQUARED), SQUARED)
    np.testing.assert_array_equal(plain.weight(SQUARED), 1.0)
