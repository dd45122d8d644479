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

from trinoc.calib.bundle.levenberg_marquardt import Observations, Point, joint_cost, minimise
from trinoc.calib.bundle.pose_prior import PosePrior
from trinoc.calib.bundle.schur import FragmentTable
from trinoc.calib.bundle.two_view_lines import placed_by_two_views
from trinoc.calib.model import CameraState
from trinoc.numerics import AbstractRobustLoss, ArrayLike, BlockArrowSolver

# Newton's steps take the minimum, known to a share of a sigma, to rounding error. Steps are of
# radians, shares of the distance, and mm.
STEP_TOLERANCE = 1e-9
MOST_NEWTON_STEPS = 8


class Offsets(NamedTuple):
    """Steps of all cameras (k,) and of all lines (t, 4) in the charts at one point."""

    cameras: Float[ArrayLike, "k"]
    lines: Float[ArrayLike, "t 4"]


def refined(
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
    fixed = jax.lax.stop_gradient((cameras, anchors_mm, tracks, prior, loss))
    state = minimise(*fixed)
    minimum = jax.lax.stop_gradient(Point(state.cameras, state.anchors_mm))
    # Lines of two views follow the cameras in closed form.
    speaks = jnp.sum(tracks.seen, axis=1) >= 3
    speaking = tracks._replace(seen=tracks.seen & speaks[:, None])
    solver = BlockArrowSolver()
    solution = optx.root_find(
        gradient_of_cost,
        optx.Newton(STEP_TOLERANCE, STEP_TOLERANCE, linear_solver=solver, cauchy_termination=False),
        Offsets(jnp.zeros(prior.values.size), jnp.zeros((len(anchors_mm), 4))),
        args=(minimum, Observations(speaking, prior, loss)),
        adjoint=optx.ImplicitAdjoint(solver),
        max_steps=MOST_NEWTON_STEPS,
        throw=False,
    )
    end = minimum.retract(solution.value)
    return end.cameras, placed_by_two_views(*end, tracks)


def gradient_of_cost(offsets: Offsets, args: tuple[Point, Observations]) -> Offsets:
    """Gradient of half the joint cost by a move of cameras and lines from a point."""
    point, observations = args

    def half_cost(offsets: Offsets) -> Float[ArrayLike, ""]:
        return 0.5 * joint_cost(*point.retract(offsets), *observations)

    return jax.grad(half_cost)(offsets)
