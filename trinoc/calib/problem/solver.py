"""Levenberg and Marquardt's method for everything whose normal equations are a block arrow.

Lenses, cameras and boards share few unknowns (the head), and every shot or line has a few of its
own (a block). The state is a point on a manifold: charts are laid anew at every point, and the
Jacobian is never formed. Source: Triggs et al., "Bundle adjustment: a modern synthesis" (2000).
"""

from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from trinoc.numerics import BlockArrow, BlockArrowSolver, ScalarLike

State = TypeVar("State")

# The cost is a chi-square: a gain this small moves no parameter by some hundredths of its sigma.
CONVERGED_GAIN = 1e-4
FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e8
# Keeps directions that nothing determines, and those that are held, at rest.
FLOOR_DAMPING = 1e-12
MOST_STEPS = 100


class ArrowEquations(NamedTuple):
    """Gauss and Newton's equations: `information` times the step is minus `gradient`.

    `information` is J^T W J, and `gradient` J^T W r, half the gradient of the cost, over the steps
    of the head (h,) and of the blocks (b, w).
    """

    information: BlockArrow
    gradient: tuple[Float[Array, "h"], Float[Array, "b w"]]


class AbstractArrowProblem(eqx.Module, Generic[State]):
    """A robust least-squares problem over states of any kind that are PyTrees of arrays.

    What is held fixed has no information, no gradient, and a `retract` that ignores its step.
    """

    @abstractmethod
    def cost(self, state: State) -> Float[Array, ""]:
        """Robust chi-square of all observations and priors: what decides on a step."""

    @abstractmethod
    def equations(self, state: State) -> ArrowEquations:
        """The equations at a state, weighted by the loss, with the priors."""

    @abstractmethod
    def retract(self, state: State, head: Float[Array, "h"], blocks: Float[Array, "b w"]) -> State:
        """The state after a step in the charts laid there; zero leaves it as it is."""


class Solution(eqx.Module, Generic[State]):
    """Where the descent ended, after how many steps, and whether it converged."""

    state: State
    cost: Float[Array, ""]
    steps: Int[Array, ""]
    converged: Bool[Array, ""]


@eqx.filter_jit
def solve(
    problem: AbstractArrowProblem[State],
    state: State,
    first_damping: ScalarLike = FIRST_DAMPING,
) -> Solution[State]:
    """The state of least cost near a start.

    first_damping : of the first step, over the diagonal of the equations. With `LEAST_DAMPING` it
    is Gauss and Newton's, for a start so near that it gains: directions that are known a million
    times less well than others move at once.

    Directions that nothing determines keep their start. Differentiating it raises: a state has
    more numbers than freedoms.
    """
    solution = optx.minimise(
        lambda state, problem: problem.cost(state),
        _ArrowDescent(first_damping=jnp.asarray(first_damping)),
        jax.tree.map(jnp.asarray, state),
        problem,
        max_steps=MOST_STEPS,
        throw=False,
    )
    return Solution(
        solution.value,
        solution.stats["cost"],
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


class _Progress(eqx.Module):
    """Cost where the descent stands, how it is damped there, and whether it may stop."""

    cost: Float[Array, ""]
    damping: Float[Array, ""]
    done: Bool[Array, ""]


class _ArrowDescent(optx.AbstractMinimiser[Any, None, _Progress]):
    """Tries a damped step from where it stands, and takes it where that gains."""

    first_damping: Float[Array, ""]
    rtol: float = 0.0  # not used: a chi-square has a scale of its own
    atol: float = CONVERGED_GAIN
    norm: Callable[[PyTree], Float[Array, ""]] = eqx.field(default=optx.max_norm, static=True)

    def init(self, fn, y, args, options, f_struct, aux_struct, tags) -> _Progress:
        """Nothing tried yet."""
        return _Progress(fn(y, args)[0], self.first_damping, jnp.asarray(False))

    def step(self, fn, y, args, options, state, tags) -> tuple[Any, _Progress, None]:
        """Try one step."""
        equations = args.equations(y)
        solver = BlockArrowSolver(state.damping + FLOOR_DAMPING, state.damping)
        negated = lx.linear_solve(
            equations.information, equations.gradient, solver, throw=False
        ).value
        tried = args.retract(y, *jax.tree.map(jnp.negative, negated))
        cost = fn(tried, args)[0]
        better = cost <= state.cost
        promised = sum(jnp.sum(g * s) for g, s in zip(equations.gradient, negated, strict=True))
        still = (promised < self.atol) & (state.cost - cost < self.atol)
        damping = jnp.where(better, state.damping / 10, state.damping * 10)
        progress = _Progress(
            jnp.where(better, cost, state.cost),
            jnp.maximum(damping, LEAST_DAMPING),
            jnp.where(better, still, (damping > MOST_DAMPING) | (promised < self.atol * 1e-3)),
        )
        return jax.tree.map(lambda new, old: jnp.where(better, new, old), tried, y), progress, None

    def terminate(self, fn, y, args, options, state, tags) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Converged, or nowhere to go; a cost that is no number ends at once."""
        failed = ~jnp.isfinite(state.cost)
        result = optx.RESULTS.where(failed, optx.RESULTS.nonfinite, optx.RESULTS.successful)
        return state.done | failed, result

    def postprocess(
        self, fn, y, aux, args, options, state, tags, result
    ) -> tuple[Any, None, dict[str, Any]]:
        """The state as it is, with its cost among the statistics."""
        return y, aux, {"cost": state.cost}


def gauss_newton_gain(equations: ArrowEquations) -> Float[Array, ""]:
    """What an undamped step takes off the cost, to first order in the residuals."""
    solver = BlockArrowSolver(FLOOR_DAMPING)
    solved = lx.linear_solve(equations.information, equations.gradient, solver, throw=False).value
    (head, blocks), (of_head, of_blocks) = solved, equations.gradient
    return of_head @ head + jnp.sum(of_blocks * blocks)
