"""Refined cameras and lines as a differentiable function of the observations.

At the minimum the gradient of the cost is zero, whatever path led there; the implicit function
theorem turns that into derivatives by fragments, by the sheet's estimate and by anything they
were computed from, without differentiating the minimisation. In the chart laid at the minimum
the true Hessian is an arrow, because a line is seen in its own fragments only: it is read off by
as many products as there are unknowns of the cameras and of one line, and solved by eliminating
the lines.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Float

from trinoc.calib.bundle.camera import CameraState
from trinoc.calib.bundle.factors import PosePrior
from trinoc.calib.bundle.joint_problem import (
    CamerasAndLines,
    FragmentTable,
    JointProblem,
    with_lines_of_two_views,
)
from trinoc.calib.problem.solver import solve
from trinoc.numerics.block_arrow import BlockArrowSolver
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss

# numerical: Newton's steps take the minimum, known to a share of a sigma, to rounding error. Steps
# are of radians, shares of the distance, and mm.
STEP_TOLERANCE, MOST_NEWTON_STEPS = 1e-9, 8


class Offsets(NamedTuple):
    """Steps of all cameras (k,) and of all lines (t, 4) in the charts at one point."""

    cameras: Float[ArrayLike, "k"]
    lines: Float[ArrayLike, "t 4"]


def refine_differentiably(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    loss: AbstractRobustLoss,
) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
    """Cameras and lines of least cost, differentiable by `tracks` and `prior`.

    `prior` must hold the gauge, as a sheet does. Derivatives by the starting values are zero:
    the minimum does not depend on them. A line that is at no minimum of its own (a wrong match
    on the flank of the loss) counts as held. For use under `jit` and `grad`, in double precision.
    """
    problem = JointProblem(tracks.in_three_views(), prior, loss)
    start = CamerasAndLines(cameras, jnp.asarray(anchors_mm))
    minimum = solve(*jax.lax.stop_gradient((problem, start))).state
    minimum = jax.lax.stop_gradient(minimum)
    solver = BlockArrowSolver()
    solution = optx.root_find(
        _gradient_of_cost,
        optx.Newton(STEP_TOLERANCE, STEP_TOLERANCE, linear_solver=solver, cauchy_termination=False),
        Offsets(jnp.zeros(prior.values.size), jnp.zeros((len(anchors_mm), 4))),
        args=(minimum, problem),
        adjoint=optx.ImplicitAdjoint(solver),
        max_steps=MOST_NEWTON_STEPS,
        throw=False,
    )
    end = with_lines_of_two_views(minimum.retract(*solution.value), tracks)
    return end.cameras, end.anchors_mm


def _gradient_of_cost(offsets: Offsets, args: tuple[CamerasAndLines, JointProblem]) -> Offsets:
    """Gradient of half the cost by a move of cameras and lines from a point."""
    minimum, problem = args
    return jax.grad(lambda move: 0.5 * problem.cost(minimum.retract(*move)))(offsets)
