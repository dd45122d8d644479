"""The least squares of one camera's pose and lens over given points."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float

from trinoc.calib.model import bucket_size
from trinoc.geometry import AbstractLens, Pose, PoseModel, project_point
from trinoc.numerics import ArrayLike, as_numpy

_MAX_STEPS = 256


class PointFit(NamedTuple):
    """Where the fit ended.

    Fields
    ------
    pose, lens : of the camera.
    residuals_px : (n, 2) predicted minus observed, of all points.
    jacobian : (n, 2, p + q) by a step of the pose, lengths in units of `distance_mm`, and by a
        step along the lens's directions.
    d_parameters_d_delta : (p, p) derivative of the pose's parameters (rad, mm) by its step.
    distance_mm : from the centre to the middle of the points, before the fit.
    converged : whether the solver says so, with all points in front.
    """

    pose: Pose
    lens: AbstractLens
    residuals_px: Float[np.ndarray, "n 2"]
    jacobian: Float[np.ndarray, "n 2 _"]
    d_parameters_d_delta: Float[np.ndarray, "p p"]
    distance_mm: float
    converged: bool


class _Data(NamedTuple):
    pose: Pose
    lens: AbstractLens
    directions: Float[ArrayLike, "q q"]
    distance_mm: Float[ArrayLike, ""]
    points_mm: Float[ArrayLike, "m 3"]
    uv_px: Float[ArrayLike, "m 2"]
    weight: Float[ArrayLike, "m"]


def fit_points(
    pose: Pose,
    lens: AbstractLens,
    directions: Float[np.ndarray, "q q"],
    points_mm: Float[np.ndarray, "n 3"],
    uv_px: Float[np.ndarray, "n 2"],
    used: Bool[np.ndarray, "n"],
    model: PoseModel,
) -> PointFit:
    """From a first camera; columns of `directions` that are zero hold their parameter."""
    count, size = len(points_mm), bucket_size(len(points_mm))
    # Rows beyond the points repeat the first one, without weight.
    row = np.where(np.arange(size) < count, np.arange(size), 0)
    weight = np.zeros(size)
    weight[:count] = used
    distance = np.linalg.norm(pose.transform(points_mm.mean(axis=0)))
    data = _Data(pose, lens, directions, np.asarray(distance), points_mm[row], uv_px[row], weight)
    end, residuals, jacobian, by_delta, in_front, converged = as_numpy(_solve(data, model=model))
    return PointFit(
        end.pose,
        end.lens,
        residuals[:count],
        jacobian[:count],
        by_delta,
        float(distance),
        bool(converged and in_front[:count][used].all() and np.isfinite(jacobian).all()),
    )


@partial(jax.jit, static_argnames="model")
def _solve(
    data: _Data, *, model: PoseModel
) -> tuple[_Data, ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike]:
    solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10, linear_solver=lx.Normal(lx.Cholesky()))
    zero = jnp.zeros(model.size + len(data.lens.parameter_names))
    solution = optx.least_squares(
        partial(_weighted, model), solver, zero, args=data, max_steps=_MAX_STEPS, throw=False
    )
    end = _retracted(model, solution.value, data)
    depth_mm = jax.vmap(end.pose.transform)(data.points_mm)[:, 2]
    return (
        end,
        _residuals(model, zero, end),
        jax.jacfwd(partial(_residuals, model))(zero, end),
        end.pose.d_parameters_d_delta(model, data.distance_mm, end.pose),
        depth_mm > 0,
        solution.result == optx.RESULTS.successful,
    )


@jax.jit
def image_shifts(
    pose: Pose,
    lens: AbstractLens,
    lens_changes: Float[ArrayLike, "q r"],
    points_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 2 r"]:
    """By how much each point's image moves, in px, for a unit of each change of the lens."""

    def images(amount: Float[ArrayLike, "r"]) -> Float[ArrayLike, "n 2"]:
        changed = lens.retract(lens_changes @ amount)
        return jax.vmap(project_point, in_axes=(None, None, 0))(pose, changed, points_mm)

    return jax.jacfwd(images)(jnp.zeros(lens_changes.shape[1]))


def _weighted(
    model: PoseModel, step: Float[ArrayLike, "s"], data: _Data
) -> Float[ArrayLike, "m 2"]:
    return data.weight[:, None] * _residuals(model, step, data)


def _residuals(
    model: PoseModel, step: Float[ArrayLike, "s"], data: _Data
) -> Float[ArrayLike, "m 2"]:
    here = _retracted(model, step, data)
    project = jax.vmap(project_point, in_axes=(None, None, 0))
    return project(here.pose, here.lens, data.points_mm) - data.uv_px


def _retracted(model: PoseModel, step: Float[ArrayLike, "s"], data: _Data) -> _Data:
    """The camera after a step of the pose and along the lens's directions."""
    pose = data.pose.retract(step[: model.size], model, data.distance_mm)
    lens = data.lens.retract(data.directions @ step[model.size :])
    return data._replace(pose=pose, lens=lens)
