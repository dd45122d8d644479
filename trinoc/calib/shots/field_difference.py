"""By how much two halves of the shots image the same points elsewhere, over each camera's field.

Each half has its own frame. One rigid motion of all cameras together brings them together, as well
as can be over the whole field at the distance of the boards; what then remains needs no frame.
Source: mrcal, "Differences in projections" of its documentation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.problem import Problem, cam_from_board
from trinoc.calib.problem.variables import Chart, RigState, step_motion
from trinoc.calib.shots.field_images import image_derivatives, images_px, points_seen
from trinoc.calib.targets import boards_of
from trinoc.numerics import ArrayLike

# Places across the picture, along each side.
_PLACES = 5
# Beyond the boards by so much: where errors of lens and pose no longer cancel.
FARTHER = 3.0
_ALIGNMENTS, _MOVES = 2, 5


class FieldDifference(NamedTuple):
    """By how much two halves of the shots have a camera image the same points elsewhere.

    Fields
    ------
    camera : its name.
    distance_mm : (2,) of the points: where the boards were, and `FARTHER` times as far.
    uv_px : (n, 2) places in the picture, along whose rays the points lie.
    difference_px : (2, n, 2) first half less second at each distance, along u and v; NaN where the
        lens has no ray.
    sigma_px : (2, n) standard deviation claimed for it, per axis.
    """

    camera: str
    distance_mm: Float[np.ndarray, "2"]
    uv_px: Float[np.ndarray, "n 2"]
    difference_px: Float[np.ndarray, "2 n 2"]
    sigma_px: Float[np.ndarray, "2 n"]

    @property
    def over_sigma(self) -> Float[np.ndarray, "2 n"]:
        """Length of the difference over that claimed: its mean square is 1 for a right model."""
        return np.linalg.norm(self.difference_px, axis=-1) / (np.sqrt(2.0) * self.sigma_px)

    @property
    def rms_px(self) -> Float[np.ndarray, "2"]:
        """Root mean square length of the difference over the field."""
        return np.sqrt(np.nanmean(np.sum(self.difference_px**2, axis=-1), axis=-1))

    @property
    def rms_over_sigma(self) -> Float[np.ndarray, "2"]:
        """Root mean square of `over_sigma` over the field."""
        return np.sqrt(np.nanmean(self.over_sigma**2, axis=-1))


def field_differences(
    problem: Problem,
    halves: Sequence[RigState],
    covariance: Float[np.ndarray, "f f"],
    cameras: tuple[str, ...],
) -> tuple[FieldDifference, ...]:
    """The maps of all cameras. `covariance` : of the difference of the halves, on the free head."""
    sizes_px = _sizes_px(problem)
    uv_px = np.stack([_grid(size) for size in sizes_px])
    near_mm = np.array([_distance_mm(problem, k) for k in range(len(cameras))])
    distance_mm = near_mm[:, None] * [1.0, FARTHER]
    points, has_ray = points_seen(problem.state, problem.chart, uv_px, distance_mm)
    by_own, by_rig = image_derivatives(problem.state, problem.chart, points)
    shape = np.shape(by_rig)[:-1]
    known = np.broadcast_to(np.asarray(has_ray)[:, None, :, None], shape)
    at_boards = np.broadcast_to((np.arange(2) == 0)[:, None, None], shape)[known]
    by_rig = np.asarray(by_rig)[known]
    along, by_head = _alignment(
        by_rig, _by_free_head(problem, np.asarray(by_own))[known], covariance, at_boards
    )
    seen = np.broadcast_to(uv_px[:, None], shape)[known]
    first, second = (_aligned(half, problem.chart, points, seen, known, along) for half in halves)
    difference_px, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    difference_px[known] = first - second
    variance[known] = np.einsum("rf,fg,rg->r", by_head, covariance, by_head)
    sigma_px = np.sqrt(variance.mean(axis=-1))
    return tuple(
        FieldDifference(name, distance_mm[k], uv_px[k], difference_px[k], sigma_px[k])
        for k, name in enumerate(cameras)
    )


def _alignment(
    by_rig: Float[np.ndarray, "r 6"],
    by_head: Float[np.ndarray, "r f"],
    covariance: Float[np.ndarray, "f f"],
    counts: Bool[np.ndarray, "r"],
) -> tuple[Float[np.ndarray, "6 r"], Float[np.ndarray, "r f"]]:
    """What takes differences to the motion of all cameras that explains most of them, and the
    derivatives of those that it leaves.

    With the second one each place has the weight of its variance after the first.
    """
    weight, along, left = counts.astype(float), np.zeros_like(by_rig.T), by_head
    for _ in range(_ALIGNMENTS):
        weighted = weight[:, None] * by_rig
        along = np.linalg.solve(weighted.T @ by_rig, weighted.T)
        left = by_head - by_rig @ (along @ by_head)
        variance = np.einsum("rf,fg,rg->r", left, covariance, left)
        weight = counts / np.maximum(variance, 1e-300)
    return along, left


def _aligned(
    half: RigState,
    chart: Chart,
    points: ArrayLike,
    seen_px: Float[np.ndarray, "r"],
    known: Bool[np.ndarray, "c 2 n 2"],
    along: Float[np.ndarray, "6 r"],
) -> Float[np.ndarray, "r"]:
    """Where a half images the points once it is moved to where these are."""
    for _ in range(_MOVES):
        off = np.asarray(images_px(half, chart, points))[known] - seen_px
        motion = np.asarray(step_motion(jnp.eye(3, 4), -(along @ off), chart.unit_mm))
        points = np.asarray(points) @ motion[:, :3].T + motion[:, 3]
    return np.asarray(images_px(half, chart, points))[known]


def _by_free_head(problem: Problem, by_own: np.ndarray) -> Float[np.ndarray, "c 2 n 2 f"]:
    """Derivatives by each camera's own lens and pose, as those by the free steps of the head."""
    chart = problem.chart
    _, size = chart.lens_shape
    whole = np.zeros((*by_own.shape[:-1], len(chart.free)))
    for camera, lens in enumerate(np.asarray(chart.lens_of_camera)):
        whole[camera, ..., lens * size : (lens + 1) * size] = by_own[camera, ..., :size]
        whole[camera, ..., chart.camera_rows(camera)] = by_own[camera, ..., size:]
    return whole[..., np.flatnonzero(chart.free)]


def _sizes_px(problem: Problem) -> list[tuple[int, int]]:
    return [
        next(view.detection.image_size_px for view in problem.views if view.camera == camera)
        for camera in range(problem.cameras)
    ]


def _grid(size_px: tuple[int, int]) -> Float[np.ndarray, "n 2"]:
    """The middles of equal parts of a picture, row by row."""
    u, v = (
        (np.arange(_PLACES) + 0.5) * side / _PLACES - 0.5 for side in np.asarray(size_px, float)
    )
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _distance_mm(problem: Problem, camera: int) -> float:
    """The median from a camera to the middles of the boards that it saw."""
    middles = [
        np.append((board.centres_mm.min(axis=0) + board.centres_mm.max(axis=0)) / 2, 0.0)
        for board in boards_of(problem.target)
    ]
    places = [
        np.append(middles[view.board], 1.0) @ cam_from_board(problem.state, view).T
        for view in problem.views
        if view.camera == camera and view.used.any()
    ]
    return float(np.median(np.linalg.norm(places, axis=1)))
