"""Levenberg and Marquardt's method over lenses, cameras and boards, on the block arrow.

A solver of optimistix' kind that steps on the manifold of poses, whose charts are laid anew at
every point; the Jacobian is never formed.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Bool, Float, Int, PyTree

from trinoc.calib.shots.normal_equations import ShotEquations, cost, shot_equations
from trinoc.calib.shots.state import Chart, RigState, retracted
from trinoc.calib.shots.table import ViewTable
from trinoc.numerics import (
    AbstractManifoldMinimiser,
    AbstractRobustLoss,
    ArrayLike,
    BlockArrow,
    BlockArrowSolver,
    DampedDescent,
)

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-3, 1e-12, 1e8
# Keeps directions that nothing determines, and those that are held, at rest.
FLOOR_DAMPING = 1e-12
MOST_STEPS = 100


class Observed(NamedTuple):
    """What the state is held against."""

    table: ViewTable
    chart: Chart
    loss: AbstractRobustLoss


class ShotFit(NamedTuple):
    """Where the minimisation ended."""

    state: RigState
    cost: Float[ArrayLike, ""]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


class ShotLevenbergMarquardt(AbstractManifoldMinimiser[RigState, None, DampedDescent]):
    """Minimises `cost` over a `RigState`, given `Observed`."""

    def init(
        self,
        fn: Any,
        y: RigState,
        args: Observed,
        options: dict[str, Any],
        f_struct: PyTree,
        aux_struct: PyTree,
        tags: frozenset[object],
    ) -> DampedDescent:
        """Nothing tried yet."""
        return DampedDescent(fn(y, args)[0], jnp.asarray(FIRST_DAMPING), jnp.asarray(False))

    def step(
        self,
        fn: Any,
        y: RigState,
        args: Observed,
        options: dict[str, Any],
        state: DampedDescent,
        tags: frozenset[object],
    ) -> tuple[RigState, DampedDescent, None]:
        """Try one step, and take it where it gains."""
        equations = shot_equations(y, args.chart, args.table, args.loss)
        head, boards = _step(equations, state.damping)
        tried = retracted(y, args.chart, head, boards)
        tried_cost = fn(tried, args)[0]
        better = tried_cost <= state.cost
        promised = -(equations.gradient[0] @ head) - jnp.sum(equations.gradient[1] * boards)
        still = (promised < self.atol) & (state.cost - tried_cost < self.atol)
        damping = jnp.where(better, state.damping / 10, state.damping * 10)
        after = DampedDescent(
            jnp.where(better, tried_cost, state.cost),
            jnp.maximum(damping, LEAST_DAMPING),
            jnp.where(better, still, (damping > MOST_DAMPING) | (promised < self.atol * 1e-3)),
        )
        return jax.tree.map(lambda new, old: jnp.where(better, new, old), tried, y), after, None


@eqx.filter_jit
def minimise(state: RigState, table: ViewTable, chart: Chart, loss: AbstractRobustLoss) -> ShotFit:
    """The state of least cost near a start; `converged` says whether it was reached."""
    solution = optx.minimise(
        lambda y, args: (cost(y, args.chart, args.table, args.loss), None),
        ShotLevenbergMarquardt(),
        jax.tree.map(jnp.asarray, state),
        Observed(table, chart, loss),
        has_aux=True,
        max_steps=MOST_STEPS,
        throw=False,
    )
    return ShotFit(
        solution.value,
        solution.stats["cost"],
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


def _step(
    equations: ShotEquations, damping: Float[ArrayLike, ""]
) -> tuple[Float[ArrayLike, "h"], Float[ArrayLike, "s 6"]]:
    """The damped Gauss-Newton step."""
    arrow = equations.information
    diagonal = jnp.einsum("sii->si", arrow.blocks)
    damped = arrow.blocks + damping * diagonal[:, :, None] * jnp.eye(diagonal.shape[1])[None]
    arrow = BlockArrow(arrow.head, arrow.coupling, damped)
    solver = BlockArrowSolver(damping + FLOOR_DAMPING)
    factored = solver.init(arrow, {})
    solution = lx.linear_solve(arrow, equations.gradient, solver, state=factored, throw=False)
    return jax.tree.map(jnp.negative, solution.value)
