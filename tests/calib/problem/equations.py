"""Law of the structured equations of shots: they are the derivatives of the cost."""

import jax
import jax.numpy as jnp
import numpy as np

from trinoc.calib.problem.equations import PointsProblem
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.reprojection import whitened_residuals
from trinoc.calib.problem.variables import RigState, evaluate_prior, retract
from trinoc.numerics.robust_loss import GemanMcClure

# `problem_of` rounds the number of shots up to this one, in all tests.
SHOTS = 8


def cost_of_points(problem: PointsProblem, state: RigState) -> jax.Array:
    """Robust chi-square of all points plus that of the prior."""
    squared = jnp.sum(
        jnp.square(whitened_residuals(state, problem.parametrization, problem.table)), axis=-1
    )
    of_views = jax.vmap(lambda loss, each: loss.rho(each))(problem.loss, squared)
    return jnp.sum(of_views) + evaluate_prior(state, problem.parametrization).cost


def assert_equations_are_those_of_the_cost(here: Problem) -> None:
    """Assert that the equations are the cost, half its gradient and its information.

    They are evaluated a little off the given state. The information is that of the residuals' own
    derivatives, weighted by the loss, plus that of the prior.
    """
    table, parametrization, state = jax.tree.map(
        jnp.asarray, (here.table, here.parametrization, here.state)
    )
    problem = PointsProblem(
        parametrization, table, GemanMcClure.from_scale(jnp.full(len(table.shot), 3.0))
    )
    off = 1e-3 * np.random.default_rng(0).normal(size=len(parametrization.free))
    start = jax.jit(retract)(state, parametrization, off, np.zeros((SHOTS, 6)))

    def at(head, boards):
        return cost_of_points(problem, problem.retract(start, head, boards))

    zero = jnp.zeros(len(parametrization.free)), jnp.zeros((SHOTS, 6))
    cost, gradients = jax.jit(jax.value_and_grad(at, argnums=(0, 1)))(*zero)
    equations = jax.jit(lambda state: problem.equations(state))(start)
    np.testing.assert_allclose(equations.cost, cost, rtol=1e-9)
    for gradient, expected in zip(equations.gradient, gradients, strict=True):
        np.testing.assert_allclose(2 * gradient, expected, rtol=1e-6, atol=1e-6)

    def residuals(head, boards):
        values = whitened_residuals(problem.retract(start, head, boards), parametrization, table)
        return values, values

    def weighed():
        by_step, values = jax.jacfwd(residuals, argnums=(0, 1), has_aux=True)(*zero)
        squared = jnp.sum(jnp.square(values), axis=-1)
        weight = jax.vmap(lambda loss, each: loss.weight(each))(problem.loss, squared)
        return by_step, weight, evaluate_prior(start, parametrization).information

    (by_head, by_boards), weight, prior_information = jax.jit(weighed)()
    weighted = np.asarray(weight)[..., None, None] * by_head
    head = np.einsum("vnih,vnig->hg", weighted, by_head)
    head += np.asarray(prior_information)
    coupling = np.einsum("vnih,vnisb->shb", weighted, by_boards)
    scale = np.sqrt(np.maximum(np.diag(head), 1.0))
    information = equations.information
    np.testing.assert_allclose(
        np.asarray(information.head) / np.outer(scale, scale),
        head / np.outer(scale, scale),
        atol=1e-8,
    )
    size = np.abs(coupling).max()
    np.testing.assert_allclose(np.asarray(information.coupling) / size, coupling / size, atol=1e-8)
