"""Steps of the extended fit: Gauss-Newton with damping on chosen unknowns."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.camera_scene import (
    CameraPrediction,
    CameraScene,
    moved_pose,
    predict_scene,
)
from trinoc.calib.photometric.clipped_noise import clipped, is_clear
from trinoc.calib.photometric.local_light import WIDTH, Elimination, eliminate_local
from trinoc.calib.photometric.noise_by_level import noise_by_level
from trinoc.calib.photometric.unknowns import CameraState

_LEAST_DAMPING, _FIRST_DAMPING, _DAMPING_FACTOR = 1e-6, 1e-3, 30.0
# Where a step does not pay, shorter ones are tried: light and its local factor are a product.
_SHARES = (1.0, 0.3, 0.1)
# A step of the pose below this many of its standard deviations ends a fit.
_SHORT_SIGMAS = 0.05


class Point(NamedTuple):
    """A state with its prediction and the noise that weighs it.

    Fields
    ------
    state, prediction : of all pixels.
    sigma : (n,) noise of each pixel before saturation.
    kept : (n,) pixels that show the sheet.
    """

    state: CameraState
    prediction: CameraPrediction
    sigma: Float[np.ndarray, "n"]
    kept: Bool[np.ndarray, "n"]


class Equations(NamedTuple):
    """Normal equations at a point, local levels eliminated.

    Fields
    ------
    matrix, gradient : (k, k) and (k,), priors included.
    rows : (k, n), through saturation.
    residual, sigma : (n,) predicted minus observed, and its standard deviation.
    weight : (n,) 1 / variance, 0 for pixels that were cut.
    local : (6, n) rows of the local levels, and their elimination; None without.
    cost : chi-square with priors.
    """

    matrix: Float[np.ndarray, "k k"]
    gradient: Float[np.ndarray, "k"]
    rows: Float[np.ndarray, "k n"]
    residual: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]
    weight: Float[np.ndarray, "n"]
    local: tuple[Float[np.ndarray, "6 n"], Elimination] | None
    cost: float


def equations_at(
    scene: CameraScene, point: Point, weight: Float[np.ndarray, "n"] | None = None
) -> Equations:
    """Normal equations; `weight` other than that of the noise for robust steps."""
    prediction, state = point.prediction, point.state
    cut = clipped(prediction.level, point.sigma, scene.top)
    residual = cut.mean - scene.grey
    if weight is None:
        weight = point.kept / cut.sigma**2
    rows = prediction.rows
    if np.isfinite(scene.top):
        rows = rows * cut.slope.astype(rows.dtype)
    if scene.blocks is not None:
        # Polynomials hardly differ from local levels: single precision loses the difference.
        rows = rows.astype(np.float64)
    middle, prior = scene.prior
    weighted = rows * weight.astype(rows.dtype)
    offset = np.r_[np.zeros(scene.model.size), state.flat] - middle
    matrix = (weighted @ rows.T).astype(np.float64) + np.diag(prior)
    gradient = weighted @ residual + prior * offset
    local = None
    if scene.blocks is not None:
        of_levels = prediction.local * cut.slope
        eliminated = eliminate_local(
            scene.blocks, rows, of_levels, weight, residual, state.levels, matrix, gradient
        )
        matrix, gradient, local = eliminated.matrix, eliminated.gradient, (of_levels, eliminated)
    cost = float(weight @ residual**2) + _prior_cost(scene, state)
    return Equations(matrix, gradient, rows, residual, cut.sigma, weight, local, cost)


def _prior_cost(scene: CameraScene, state: CameraState) -> float:
    middle, prior = (part[scene.model.size :] for part in scene.prior)
    return float(prior @ (state.flat - middle) ** 2 + np.sum((state.levels.T / WIDTH) ** 2))


def stepped(
    scene: CameraScene,
    state: CameraState,
    sums: Equations,
    active: list[int],
    damping: float,
    share: float = 1.0,
) -> tuple[CameraState, Float[np.ndarray, "k"]]:
    """The state after a share of a damped step of the active unknowns, and the whole step."""
    step = np.zeros(scene.layout.size)
    matrix = sums.matrix[np.ix_(active, active)]
    scale = 1 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled = matrix * scale[:, None] * scale + damping * np.eye(len(active))
    step[active] = -scale * np.linalg.lstsq(scaled, scale * sums.gradient[active])[0]
    pose = moved_pose(state.pose, share * step[: scene.model.size], scene.model)
    levels = state.levels
    if sums.local is not None:
        levels = levels + share * (sums.local[1].stepped(levels, step) - levels)
    return state.moved(pose, share * step[scene.model.size :], levels), step


def settle(scene: CameraScene, point: Point, active: list[int], most_steps: int) -> Point:
    """Damped steps until the pose moves no more; noise and pixels stay as they are."""
    damping, sums = _LEAST_DAMPING, equations_at(scene, point)
    for _ in range(most_steps):
        for share in _SHARES:
            state, step = stepped(scene, point.state, sums, active, damping, share)
            prediction = predict_scene(scene, state)
            cut = clipped(prediction.level, point.sigma, scene.top)
            cost = float(sums.weight @ (cut.mean - scene.grey) ** 2) + _prior_cost(scene, state)
            if cost <= sums.cost * (1 + 1e-5) + 0.1:
                break
            damping = max(damping * _DAMPING_FACTOR, _FIRST_DAMPING)
        else:
            break
        length = _pose_length(sums.matrix, step, active, scene.model.size)
        point = point._replace(state=state, prediction=prediction)
        damping = max(damping / _DAMPING_FACTOR, _LEAST_DAMPING)
        if length < _SHORT_SIGMAS:
            break
        sums = equations_at(scene, point)
    return point


def reweighted(scene: CameraScene, point: Point, *, robust: bool = False) -> Point:
    """With the noise that the residuals of the kept pixels show."""
    level = point.prediction.level
    residual = clipped(level, point.sigma, scene.top).mean - scene.grey
    clear = point.kept & is_clear(level, point.sigma, scene.top)
    scale = scene.noise_scale
    sigma = noise_by_level(level, residual / scale, clear, level, robust=robust)
    return point._replace(sigma=sigma * scale)


def pose_information(
    matrix: Float[np.ndarray, "k k"], active: list[int], pose_size: int
) -> Float[np.ndarray, "p p"]:
    """Information of the pose after the active unknowns have taken their share."""
    return matrix[:pose_size, :pose_size] - matrix[:pose_size] @ share_of_rest(
        matrix, active, pose_size
    )


def share_of_rest(
    matrix: Float[np.ndarray, "k k"], active: list[int], pose_size: int
) -> Float[np.ndarray, "k p"]:
    """By how much the other active unknowns follow the pose, 0 for those that are held."""
    rest = [k for k in active if k >= pose_size]
    inner = matrix[np.ix_(rest, rest)]
    scale = 1 / np.sqrt(np.maximum(np.diag(inner), 1e-300))
    scaled = inner * scale[:, None] * scale
    follow = np.zeros((len(matrix), pose_size))
    side = scale[:, None] * matrix[rest, :pose_size]
    follow[rest] = scale[:, None] * np.linalg.lstsq(scaled, side)[0]
    return follow


def _pose_length(
    matrix: Float[np.ndarray, "k k"], step: Float[np.ndarray, "k"], active: list[int], size: int
) -> float:
    information = pose_information(matrix, active, size)
    return float(np.sqrt(max(step[:size] @ information @ step[:size], 0.0)))
