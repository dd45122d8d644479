"""The pose of one camera from its circles, by Levenberg-Marquardt."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Bool, Float, Int

from trinoc.calib.model import CircleObservations, circle_residuals_px, whitened_residuals
from trinoc.calib.pose.initial import initial_pose_from_circles, initial_pose_from_lines
from trinoc.geometry import AbstractLens, Pose, PoseModel
from trinoc.numerics import ArrayLike, GemanMcClure, kept_jit

MAX_STEPS = 64
# Steps are in rad and in shares of the distance; a good sheet determines them to 1e-5.
_STEP_TOLERANCE = 1e-8
_COST_TOLERANCE = 1e-6


class CircleFit(NamedTuple):
    """Where the fit ended, before anybody has judged it.

    Fields
    ------
    pose : the last accepted pose.
    parameters : (p,) pan, tilt, swing in rad, distance and, where it is free, the aim in mm.
    residuals_px : (n, 2) predicted minus observed, at `pose`.
    whitened : (n, 2) the same in units of their standard deviations; zero for unused rows.
    information : (p, p) J^T J of the whitened residuals by a step of `pose.retract`, lengths in
        units of its distance.
    d_parameters_d_delta : (p, p) derivative of `parameters` with respect to that step.
    steps : number of steps taken.
    converged : whether the solver says so.
    """

    pose: Pose
    parameters: Float[ArrayLike, "p"]
    residuals_px: Float[ArrayLike, "n 2"]
    whitened: Float[ArrayLike, "n 2"]
    information: Float[ArrayLike, "p p"]
    d_parameters_d_delta: Float[ArrayLike, "p p"]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


def fit_circles(
    start: Pose,
    lens: AbstractLens,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    model: PoseModel,
) -> CircleFit:
    """Least squares over the circles from a first camera, the aim held or free.

    `outlier_scale` bounds the influence of a circle whose whitened error is larger, by the
    function of Geman and McClure; infinity is plain least squares.
    """
    solver = optx.LevenbergMarquardt(
        rtol=_COST_TOLERANCE, atol=_STEP_TOLERANCE, linear_solver=lx.Normal(lx.Cholesky())
    )
    zero = jnp.zeros(model.size, dtype=start.rotation.dtype)
    solution = optx.least_squares(
        partial(_bounded_residuals, model),
        solver,
        zero,
        args=(start, lens, circles, outlier_scale),
        max_steps=MAX_STEPS,
        throw=False,
    )
    pose = start.retract(solution.value, model, start.distance_mm)
    # What the solver hands back belongs to the last point it tried: look again at the last
    # one it accepted.
    whitened = whitened_residuals(pose, lens, circles)
    jacobian = jax.jacfwd(
        lambda step: whitened_residuals(pose.retract(step, model, pose.distance_mm), lens, circles)
    )(zero)
    jacobian = jacobian.reshape(-1, model.size)
    return CircleFit(
        pose,
        pose.model_parameters(model, start),
        circle_residuals_px(pose, lens, circles),
        whitened,
        jacobian.T @ jacobian,
        pose.d_parameters_d_delta(model, pose.distance_mm, start),
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )


def _bounded_residuals(
    model: PoseModel,
    step: Float[ArrayLike, "p"],
    args: tuple[Pose, AbstractLens, CircleObservations, Float[ArrayLike, ""]],
) -> Float[ArrayLike, "n 2"]:
    start, lens, circles, outlier_scale = args
    whitened = whitened_residuals(start.retract(step, model, start.distance_mm), lens, circles)
    squared = jnp.sum(whitened * whitened, axis=1, keepdims=True)
    return GemanMcClure.from_scale(outlier_scale).bounded(whitened, squared)


def fit_from_lines(
    lens: AbstractLens,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    model: PoseModel,
) -> CircleFit:
    """First camera from the crossed lines, then the fit."""
    start = initial_pose_from_lines(lens, circles, model is PoseModel.AIM_FREE)
    return fit_circles(start, lens, circles, outlier_scale, model)


def fit_from_circles(
    lens: AbstractLens,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, ""],
    model: PoseModel,
) -> CircleFit:
    """First camera from the circles' homography, then the fit."""
    start = initial_pose_from_circles(lens, circles, model is PoseModel.AIM_FREE)
    return fit_circles(start, lens, circles, outlier_scale, model)


@partial(kept_jit, static_argnames=("model",))
def fit_images_from_lines(
    lens: AbstractLens, circles: CircleObservations, *, model: PoseModel
) -> CircleFit:
    """`fit_from_lines` over a first axis of pictures."""

    def fit(lens: AbstractLens, circles: CircleObservations) -> CircleFit:
        return fit_from_lines(lens, circles, jnp.full((), jnp.inf), model)

    return jax.vmap(fit)(lens, circles)


@partial(kept_jit, static_argnames=("model",))
def fit_images_from_circles(
    lens: AbstractLens, circles: CircleObservations, *, model: PoseModel
) -> CircleFit:
    """`fit_from_circles` over a first axis of pictures."""

    def fit(lens: AbstractLens, circles: CircleObservations) -> CircleFit:
        return fit_from_circles(lens, circles, jnp.full((), jnp.inf), model)

    return jax.vmap(fit)(lens, circles)


@partial(kept_jit, static_argnames=("model",))
def refit_images(
    start: Pose,
    lens: AbstractLens,
    circles: CircleObservations,
    outlier_scale: Float[ArrayLike, "k"],
    *,
    model: PoseModel,
) -> CircleFit:
    """`fit_circles` over a first axis of pictures."""
    fit = partial(fit_circles, model=model)
    return jax.vmap(fit)(start, lens, circles, outlier_scale)
