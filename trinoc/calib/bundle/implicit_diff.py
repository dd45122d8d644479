"""Refined cameras and lines as a differentiable function of the observations.

At the minimum the gradient of the cost is zero. The implicit function theorem gives the derivatives
by fragments, by the sheet's estimate and by all their inputs, without differentiating the
minimisation. In local coordinates at the minimum the true Hessian is an arrow, because a line
appears only in its own fragments. It is evaluated by as many products as there are unknowns of the
cameras and of one line, and solved by eliminating the lines.
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

# numerical: Newton steps from an approximate minimum to rounding error. Steps are in radians,
# shares of the distance, and mm.
STEP_TOLERANCE, MOST_NEWTON_STEPS = 1e-9, 8


class Offsets(NamedTuple):
    """Steps of all cameras (k,) and of all lines (t, 4) in local coordinates at one point."""

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

    Parameters
    ----------
    cameras, anchors_mm : start of the cameras and of the lines, (t, 2, 3). Derivatives by the start
        are zero, since the minimum does not depend on it.
    tracks : fragments of the lines.
    prior : prior of the cameras, which must determine the gauge, as a sheet does.
    loss : robust loss of the fragments' distances.

    Returns
    -------
    The refined cameras and anchors.

    Notes
    -----
    A line that is at no minimum of its own (a wrong match on the flank of the loss) is treated as
    fixed. For use under `jit` and `grad`, in double precision.
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
    """Gradient of half the cost by an offset of cameras and lines."""
    minimum, problem = args
    return jax.grad(lambda move: 0.5 * problem.cost(minimum.retract(*move)))(offsets)
