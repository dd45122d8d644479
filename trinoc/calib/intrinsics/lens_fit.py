"""The lens and the pose of each picture from the circles, by Levenberg-Marquardt."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from trinoc.calib.intrinsics.lens_residual import (
    LensChart,
    information_of_images,
    residuals_px,
    retract_pose,
    whitened_residuals,
)
from trinoc.calib.model import CircleObservations
from trinoc.geometry import AbstractLens, PoseModel
from trinoc.numerics import ArrayLike, BlockArrowSolver, GemanMcClure

MAX_STEPS = 100
# The solver ends when no residual changes by more than this, in standard deviations, and no
# unknown, in the units of `retract_pose` and `parameter_scales`. The last step is then far shorter:
# convergence is quadratic. Far finer tolerances are below rounding and never met.
_TOLERANCE = 1e-4


class LensFit(NamedTuple):
    """Where the fit ended, before anybody has judged it.

    Fields
    ------
    lens : q parameters.
    cam_from_world : (k, 3, 4) pose of each picture, mm.
    residuals_px : (k, n, 2) predicted minus observed.
    whitened : (k, n, 2) the same in units of their standard deviations; zero for unused rows.
    scale : (q,) units of the lens's parameters in `information`.
    information : (k, s, s) J^T J of each picture's whitened residuals, over all q parameters of
        the lens and the six of the picture's motion.
    steps : number of steps taken.
    converged : whether the solver says so.
    """

    lens: AbstractLens
    cam_from_world: Float[ArrayLike, "k 3 4"]
    residuals_px: Float[ArrayLike, "k n 2"]
    whitened: Float[ArrayLike, "k n 2"]
    scale: Float[ArrayLike, "q"]
    information: Float[ArrayLike, "k s s"]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


@jax.jit
def fit_lens(
    chart: LensChart, circles: CircleObservations, outlier_scale: Float[ArrayLike, ""]
) -> LensFit:
    """Least squares over the free parameters of the lens and six of each picture's pose.

    `outlier_scale` bounds the influence of a circle whose whitened error is larger, by the
    function of Geman and McClure; infinity is plain least squares.
    """
    solver = optx.LevenbergMarquardt(
        rtol=_TOLERANCE, atol=_TOLERANCE, linear_solver=lx.Normal(BlockArrowSolver())
    )
    count = chart.cam_from_world.shape[0]
    motions = jnp.zeros((count, PoseModel.RIGID.size), chart.scale.dtype)
    zero = (jnp.zeros_like(chart.scale), motions)
    solution = optx.least_squares(
        _bounded_residuals,
        solver,
        zero,
        args=(chart, circles, outlier_scale),
        max_steps=MAX_STEPS,
        throw=False,
    )
    lens_step, motions = solution.value
    lens = chart.stepped_lens(lens_step)
    poses = jax.vmap(retract_pose)(chart.cam_from_world, motions)
    residuals = residuals_px(lens, poses, circles)
    return LensFit(
        lens,
        poses,
        residuals,
        jnp.einsum("knij,knj->kni", circles.whitening, residuals),
        chart.scale,
        information_of_images(lens, chart.scale, poses, circles),
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


def _bounded_residuals(
    steps: tuple[Float[Array, "q"], Float[Array, "k 6"]],
    args: tuple[LensChart, CircleObservations, Float[ArrayLike, ""]],
) -> Float[Array, "k n 2"]:
    chart, circles, outlier_scale = args
    whitened = whitened_residuals(*steps, chart, circles)
    squared = jnp.sum(whitened * whitened, axis=2, keepdims=True)
    return jnp.asarray(GemanMcClure.from_scale(outlier_scale).bounded(whitened, squared))
