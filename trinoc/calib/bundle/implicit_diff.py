"""Refined cameras and lines as a differentiable function of the observations.

At the minimum the gradient of the cost is zero. The implicit function theorem then gives the
derivatives with respect to observations and prior, without differentiating the minimisation. In
local coordinates at the minimum the Hessian is a block arrow, because a line appears only in its
own observations. It is evaluated by as many products as one line and all cameras have unknowns, and
solved by eliminating the lines.
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
    """Small changes of all unknowns, in local coordinates.

    Attributes
    ----------
    cameras : (k,) change of all cameras.
    lines : (t, 4) change of each line.
    """

    cameras: Float[ArrayLike, "k"]
    lines: Float[ArrayLike, "t 4"]


def refine_differentiably(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    loss: AbstractRobustLoss,
) -> tuple[CameraState, Float[ArrayLike, "t 2 3"]]:
    """Refine cameras and lines, as a function that JAX can differentiate.

    Derivatives with respect to `tracks` and `prior` come from the implicit function theorem. Use it
    in double precision, inside `jit` and `grad`.

    Parameters
    ----------
    cameras : initial cameras, stacked.
    anchors_mm : (t, 2, 3) initial lines, as two points each. Derivatives with respect to initial
        values are zero, because the minimum does not depend on them.
    tracks : fragments of the lines.
    prior : prior of the cameras. It must determine position, orientation and scale of the rig.
    loss : robust loss of the distances between fragments and lines.

    Returns
    -------
    The refined cameras and lines.

    Notes
    -----
    The cost of a wrong match may have no minimum in the four coordinates of its line. Such a line
    is treated as fixed.
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
    """Gradient of half the cost with respect to small changes of cameras and lines at `offsets`."""
    minimum, problem = args
    return jax.grad(lambda move: 0.5 * problem.cost(minimum.retract(*move)))(offsets)
