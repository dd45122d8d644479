"""The least squares of one camera's pose and lens over given points."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float

from trinoc.calib.model import bucket_size
from trinoc.geometry import Pose, distort
from trinoc.numerics import ArrayLike

_MAX_STEPS = 256


class PointFit(NamedTuple):
    """Where the fit ended.

    Fields
    ------
    cam_from_world : (3, 4).
    lens : (9,) LENS_PARAMETERS.
    residuals_px : (n, 2) predicted minus observed, of all points.
    jacobian : (n, 2, 15) by turns in rad, the centre in distances, and the lens's directions.
    distance_mm : from the centre to the middle of the points.
    converged : whether the solver says so, with all points in front.
    """

    cam_from_world: Float[np.ndarray, "3 4"]
    lens: Float[np.ndarray, "9"]
    residuals_px: Float[np.ndarray, "n 2"]
    jacobian: Float[np.ndarray, "n 2 15"]
    distance_mm: float
    converged: bool


class _Data(NamedTuple):
    cam_from_world: Float[ArrayLike, "3 4"]
    lens: Float[ArrayLike, "9"]
    directions: Float[ArrayLike, "9 9"]
    distance_mm: Float[ArrayLike, ""]
    points_mm: Float[ArrayLike, "m 3"]
    uv_px: Float[ArrayLike, "m 2"]
    weight: Float[ArrayLike, "m"]


def fit_points(
    cam_from_world: Float[np.ndarray, "3 4"],
    lens: Float[np.ndarray, "9"],
    directions: Float[np.ndarray, "9 9"],
    points_mm: Float[np.ndarray, "n 3"],
    uv_px: Float[np.ndarray, "n 2"],
    used: Bool[np.ndarray, "n"],
) -> PointFit:
    """From a first camera; columns of `directions` that are zero hold their parameter."""
    count, size = len(points_mm), bucket_size(len(points_mm))
    # Rows beyond the points repeat the first one, without weight.
    row = np.where(np.arange(size) < count, np.arange(size), 0)
    weight = np.zeros(size)
    weight[:count] = used
    middle = points_mm.mean(axis=0)
    distance = np.asarray(np.linalg.norm(cam_from_world[:, :3] @ middle + cam_from_world[:, 3]))
    data = _Data(cam_from_world, lens, directions, distance, points_mm[row], uv_px[row], weight)
    pose, values, residuals, jacobian, in_front, converged = jax.tree.map(np.asarray, _solve(data))
    return PointFit(
        pose,
        values,
        residuals[:count],
        jacobian[:count],
        float(distance),
        bool(converged and in_front[:count][used].all() and np.isfinite(jacobian).all()),
    )


@jax.jit
def _solve(data: _Data) -> tuple[ArrayLike, ...]:
    solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10, linear_solver=lx.Normal(lx.Cholesky()))
    zero = jnp.zeros(15)
    solution = optx.least_squares(
        _weighted, solver, zero, args=data, max_steps=_MAX_STEPS, throw=False
    )
    pose, lens = _moved(solution.value, data)
    depth_mm = data.points_mm @ pose[2, :3] + pose[2, 3]
    return (
        pose,
        lens,
        _residuals(solution.value, data),
        jax.jacfwd(_chart_residuals)(zero, pose, lens, data),
        depth_mm > 0,
        solution.result == optx.RESULTS.successful,
    )


def _weighted(step: Float[ArrayLike, "15"], data: _Data) -> Float[ArrayLike, "m 2"]:
    return data.weight[:, None] * _residuals(step, data)


def _residuals(step: Float[ArrayLike, "15"], data: _Data) -> Float[ArrayLike, "m 2"]:
    return _chart_residuals(step, data.cam_from_world, data.lens, data)


def _chart_residuals(
    step: Float[ArrayLike, "15"],
    cam_from_world: Float[ArrayLike, "3 4"],
    lens: Float[ArrayLike, "9"],
    data: _Data,
) -> Float[ArrayLike, "m 2"]:
    pose, values = _moved(step, data._replace(cam_from_world=cam_from_world, lens=lens))

    def residual(point: Float[ArrayLike, "3"], uv: Float[ArrayLike, "2"]) -> ArrayLike:
        ray = pose[:, :3] @ point + pose[:, 3]
        return values[:2] * distort(ray[:2] / ray[2], values[4:]) + values[2:4] - uv

    return jax.vmap(residual)(data.points_mm, data.uv_px)


def _moved(
    step: Float[ArrayLike, "15"], data: _Data
) -> tuple[Float[ArrayLike, "3 4"], Float[ArrayLike, "9"]]:
    motion = jnp.concatenate([step[:3], data.distance_mm * step[3:6]])
    pose = Pose(data.cam_from_world).moved(motion).cam_from_world
    return pose, data.lens + data.directions @ step[6:]
