"""The pose of one camera from its circles, by Levenberg-Marquardt."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Bool, Float, Int

from trinoc.calib.model import (
    CircleObservations,
    LensArrays,
    SheetPose,
    circle_residuals_px,
    whitened_residuals,
)
from trinoc.calib.pose.initial import initial_pose_from_circles, initial_pose_from_lines
from trinoc.numerics import ArrayLike, GemanMcClure

MAX_STEPS = 64
# Steps are in rad and in shares of the distance; a good sheet determines them to 1e-5.
_STEP_TOLERANCE = 1e-8
_COST_TOLERANCE = 1e-6


class CircleFit(NamedTuple):
    """Where the fit ended, before anybody has judged it.

    Fields
    ------
    pose : the last accepted pose.
    parameters : (6,) pan, tilt, swing in rad, distance, aim X, aim Y in mm.
    residuals_px : (n, 2) predicted minus observed, at `pose`.
    whitened : (n, 2) the same in units of their standard deviations; zero for unused rows.
    information : (p, p) J^T J of the whitened residuals with respect to the chart of `pose`.
    parameters_by_chart : (6, p) derivative of `parameters` with respect to that chart.
    steps : number of steps taken.
    converged : whether the solver says so.
    """

    pose: SheetPose
    parameters: Float[ArrayLike, "6"]
    residuals_px: Float[ArrayLike, "n 2"]
    whitened: Float[ArrayLike, "n 2"]
    information: Float[ArrayLike, "p p"]
    parameters_by_chart: Float[ArrayLike, "6 p"]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


def fit_circles(
    start: SheetPose,
    lens: LensArrays,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    parameter_count: int,
) -> CircleFit:
    """Least squares over the circles from a first camera, with 4 (aim held) or 6 parameters.

    `outlier_scale` bounds the influence of a circle whose whitened error is larger, by the
    function of Geman and McClure; infinity is plain least squares.
    """
    solver = optx.LevenbergMarquardt(
        rtol=_COST_TOLERANCE, atol=_STEP_TOLERANCE, linear_solver=lx.Normal(lx.Cholesky())
    )
    zero = jnp.zeros(parameter_count, dtype=start.rotation.dtype)
    solution = optx.least_squares(
        _bounded_residuals,
        solver,
        zero,
        args=(start, lens, circles, outlier_scale),
        max_steps=MAX_STEPS,
        throw=False,
    )
    pose = start.moved(solution.value)
    # What the solver hands back belongs to the last point it tried: look again at the last
    # one it accepted.
    whitened = whitened_residuals(pose, lens, circles)
    jacobian = jax.jacfwd(lambda step: whitened_residuals(pose.moved(step), lens, circles))(zero)
    jacobian = jacobian.reshape(-1, parameter_count)
    return CircleFit(
        pose,
        pose.parameters,
        circle_residuals_px(pose, lens, circles),
        whitened,
        jacobian.T @ jacobian,
        jax.jacfwd(lambda step: pose.moved(step).parameters)(zero),
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


def _bounded_residuals(
    step: Float[ArrayLike, "p"],
    args: tuple[SheetPose, LensArrays, CircleObservations, Float[ArrayLike, ""]],
) -> Float[ArrayLike, "n 2"]:
    start, lens, circles, outlier_scale = args
    whitened = whitened_residuals(start.moved(step), lens, circles)
    squared = jnp.sum(whitened * whitened, axis=1, keepdims=True)
    return GemanMcClure.from_scale(outlier_scale).bounded(whitened, squared)


def fit_from_lines(
    lens: LensArrays,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    parameter_count: int,
) -> CircleFit:
    """First camera from the crossed lines, then the fit."""
    start = initial_pose_from_lines(lens, circles, parameter_count == 6)
    return fit_circles(start, lens, circles, outlier_scale, parameter_count)


def fit_from_circles(
    lens: LensArrays,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    parameter_count: int,
) -> CircleFit:
    """First camera from the circles' homography, then the fit."""
    start = initial_pose_from_circles(lens, circles, parameter_count == 6)
    return fit_circles(start, lens, circles, outlier_scale, parameter_count)


@partial(jax.jit, static_argnames="parameter_count")
def fit_images_from_lines(
    lens: LensArrays, circles: CircleObservations, *, parameter_count: int
) -> CircleFit:
    """`fit_from_lines` over a first axis of pictures."""

    def fit(lens: LensArrays, circles: CircleObservations) -> CircleFit:
        return fit_from_lines(lens, circles, jnp.full((), jnp.inf), parameter_count)

    return jax.vmap(fit)(lens, circles)


@partial(jax.jit, static_argnames="parameter_count")
def fit_images_from_circles(
    lens: LensArrays, circles: CircleObservations, *, parameter_count: int
) -> CircleFit:
    """`fit_from_circles` over a first axis of pictures."""

    def fit(lens: LensArrays, circles: CircleObservations) -> CircleFit:
        return fit_from_circles(lens, circles, jnp.full((), jnp.inf), parameter_count)

    return jax.vmap(fit)(lens, circles)


@partial(jax.jit, static_argnames="parameter_count")
def refit_images(
    start: SheetPose,
    lens: LensArrays,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, "k"],
    *,
    parameter_count: int,
) -> CircleFit:
    """`fit_circles` over a first axis of pictures."""
    fit = partial(fit_circles, parameter_count=parameter_count)
    return jax.vmap(fit)(start, lens, circles, outlier_scale)
