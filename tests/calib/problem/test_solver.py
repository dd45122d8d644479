"""The descent reaches the minimum that dense methods reach, and reports convergence."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from trinoc.calib.problem.solver import (
    LEAST_DAMPING,
    AbstractArrowProblem,
    AbstractSeparableProblem,
    ArrowEquations,
    Costs,
    solve,
)
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.robust_loss import GemanMcClure

COUNT, ROWS = 6, 5


class Decays(AbstractArrowProblem[tuple[Array, Array]]):
    """Curves a_k exp(-b_k t) + c + d t sampled at times t, with common c and d.

    c has a prior of mean 0. A step changes the log of each b_k, so that it stays positive.
    """

    time: Float[Array, "n"]
    samples: Float[Array, "k n"]
    loss: GemanMcClure
    prior: Float[Array, ""]

    def residuals(self, state):
        (c, d), curves = state
        amplitude, rate = curves[:, :1], curves[:, 1:]
        return amplitude * jnp.exp(-rate * self.time[None]) + c + d * self.time[None] - self.samples

    def cost(self, state):
        return jnp.sum(self.loss.rho(self.residuals(state) ** 2)) + self.prior * state[0][0] ** 2

    def equations(self, state):
        zero = jnp.zeros(2), jnp.zeros((len(self.samples), 2))
        by_head, by_block = jax.jacfwd(
            lambda *step: self.residuals(self.retract(state, *step)), argnums=(0, 1)
        )(*zero)
        by_block = jnp.einsum("knkw->knw", by_block)
        residual = self.residuals(state)
        weight = self.loss.weight(residual**2)
        prior = self.prior * jnp.array([1.0, 0.0])
        return ArrowEquations(
            self.cost(state),
            BlockArrow(
                jnp.einsum("kn,kni,knj->ij", weight, by_head, by_head) + jnp.diag(prior),
                jnp.einsum("kn,kni,knj->kij", weight, by_head, by_block),
                jnp.einsum("kn,kni,knj->kij", weight, by_block, by_block),
            ),
            (
                jnp.einsum("kn,kni,kn->i", weight, by_head, residual) + prior * state[0],
                jnp.einsum("kn,kni,kn->ki", weight, by_block, residual),
            ),
        )

    def retract(self, state, head, blocks):
        shared, curves = state
        moved = jnp.stack(
            [curves[:, 0] + blocks[:, 0], curves[:, 1] * jnp.exp(blocks[:, 1])], axis=1
        )
        return shared + head, moved


class SeparateDecays(AbstractSeparableProblem[tuple[Array, Array]]):
    """The same curves, each damped by itself."""

    joint: Decays

    def costs(self, state):
        by_curve = jnp.sum(self.joint.loss.rho(self.joint.residuals(state) ** 2), axis=1)
        return Costs(self.joint.prior * state[0][0] ** 2, by_curve)

    def equations(self, state):
        return self.joint.equations(state)

    def retract(self, state, head, blocks):
        return self.joint.retract(state, head, blocks)


def decays(seed=0, scale=np.inf):
    random = np.random.default_rng(seed)
    time = jnp.linspace(0.0, 3.0, ROWS)
    curves = np.stack([random.uniform(2, 4, COUNT), random.uniform(0.5, 2, COUNT)], axis=1)
    truth = jnp.array([0.3, -0.2]), jnp.asarray(curves)
    empty = Decays(time, jnp.zeros((COUNT, ROWS)), GemanMcClure(jnp.asarray(scale)), jnp.ones(()))
    samples = empty.residuals(truth) + 0.02 * random.normal(size=(COUNT, ROWS))
    start = jnp.zeros(2), jnp.asarray(curves * random.uniform(0.5, 1.5, curves.shape))
    return Decays(time, samples, empty.loss, empty.prior), start


@pytest.mark.parametrize("scale", [np.inf, 0.5])
@pytest.mark.parametrize("each_by_itself", [False, True])
def test_it_ends_where_a_dense_method_does(scale, each_by_itself):
    problem, start = decays(scale=scale)
    solution = solve(SeparateDecays(problem) if each_by_itself else problem, start)
    zero, unflatten = ravel_pytree((jnp.zeros(2), jnp.zeros((COUNT, 2))))

    def bounded(step):
        state = problem.retract(start, *unflatten(jnp.asarray(step)))
        rho = problem.loss.rho(problem.residuals(state) ** 2)
        return np.append(np.sqrt(rho).ravel(), state[0][0])

    dense = least_squares(bounded, np.asarray(zero), xtol=1e-12, ftol=1e-12)
    assert solution.converged
    np.testing.assert_allclose(solution.cost, problem.cost(solution.state), rtol=1e-12)
    assert solution.cost <= 2 * dense.cost + 1e-4


def test_at_a_minimum_it_stays():
    problem, start = decays()
    first = solve(problem, start)
    second_run = solve(problem, first.state)
    assert second_run.converged
    assert second_run.steps <= 3
    assert second_run.cost <= first.cost < second_run.cost + 1e-4


def test_the_first_damping_is_that_of_the_first_step():
    """Each successful step divides the damping by ten. Steps are short until it is small."""
    problem, start = decays()
    steps = [int(solve(problem, start, damping).steps) for damping in (1e-3, 1.0, 1e3)]
    assert steps[1] >= steps[0] + 1
    assert steps[2] >= steps[1] + 3


def test_a_start_without_a_cost_is_no_answer():
    problem, (shared, curves) = decays()
    assert not solve(problem, (shared, curves.at[0, 0].set(jnp.nan))).converged


class CurvedValley(AbstractArrowProblem[tuple[Array, Array]]):
    """Problem with x known to 1 and y - x^2 to 1e-4.

    A straight step leaves the valley by the square of the step.
    """

    def residuals(self, x, y):
        return jnp.concatenate([x - 0.3, (y[:, 0] - x**2) / 1e-4])

    def cost(self, state):
        return jnp.sum(self.residuals(*state) ** 2)

    def equations(self, state):
        by_x, by_y = (each[..., 0] for each in jax.jacfwd(self.residuals, (0, 1))(*state))
        by_y, residual = by_y[:, 0], self.residuals(*state)
        head, coupling, block = by_x @ by_x, by_x @ by_y, by_y @ by_y
        arrow = BlockArrow(
            head[None, None], jnp.reshape(coupling, (1, 1, 1)), jnp.reshape(block, (1, 1, 1))
        )
        gradient = (by_x @ residual)[None], (by_y @ residual)[None, None]
        return ArrowEquations(self.cost(state), arrow, gradient)

    def retract(self, state, head, blocks):
        return state[0] + head, state[1] + blocks


@pytest.mark.parametrize("offset", [0.05, 0.2, -0.2])
def test_a_curved_valley_is_crossed_by_steps_that_rise_at_first(offset):
    start = jnp.array([0.3 + offset]), jnp.array([[(0.3 + offset) ** 2]])
    solution = solve(CurvedValley(), start, LEAST_DAMPING)
    assert solution.converged
    np.testing.assert_allclose(solution.state[0], 0.3, atol=0.01)
    assert solution.steps <= 4
