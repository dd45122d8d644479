"""By how much two halves of the shots image the same points elsewhere, over each camera's field.

Each half has its own frame. One rigid motion of all cameras together brings them together, as well
as can be over the whole field at the distance of the boards; what then remains needs no frame.
Source: mrcal, "Differences in projections" of its documentation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.problem.problem import Problem, cam_from_board, lens_number
from trinoc.calib.problem.variables import (
    POSE_SIZE,
    Parametrization,
    RigState,
    retract,
    step_motion,
)
from trinoc.calib.result.halves import FieldDifference
from trinoc.calib.starts.sightings import IN_PLACE
from trinoc.calib.targets.board_set import list_boards
from trinoc.calib.uncertainty.propagation import MAP_PLACES
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_point, project_points, unproject_pixels
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: rounds that converge, of weights and of a motion.
_ALIGNMENTS, _MOVES = 2, 5
# numerical: a place that a lens does not give back after so much has no ray.
_SAME_PX = 1e-3


def field_differences(
    problem: Problem,
    halves: Sequence[RigState],
    covariance: Float[np.ndarray, "f f"],
    cameras: tuple[str, ...],
) -> tuple[FieldDifference, ...]:
    """The maps of all cameras. `covariance` : of the difference of the halves, on the free head."""
    fields = [_image_field(problem, k) for k in range(len(cameras))]
    points = np.stack([field.points for field in fields])
    by_motion, by_head = _derivatives(problem.state, problem.parametrization, points)
    shape = np.shape(by_motion)[:-1]
    known = np.stack([field.has_ray for field in fields])
    known = np.broadcast_to(known[:, None, :, None], shape)
    at_boards = np.broadcast_to((np.arange(2) == 0)[:, None, None], shape)[known]
    free = np.flatnonzero(problem.free)
    along, by_free = _alignment(
        np.asarray(by_motion)[known], np.asarray(by_head)[known][:, free], covariance, at_boards
    )
    seen_px = np.broadcast_to(np.stack([f.uv_px for f in fields])[:, None], shape)[known]
    first, second = (
        _align_half(half, problem.parametrization, points, seen_px, known, along) for half in halves
    )
    difference_px, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    difference_px[known] = first - second
    variance[known] = np.einsum("rf,fg,rg->r", by_free, covariance, by_free)
    sigma_px = np.sqrt(variance.mean(axis=-1))
    return tuple(
        FieldDifference(name, field.distance_mm, field.uv_px, difference_px[k], sigma_px[k])
        for k, (name, field) in enumerate(zip(cameras, fields, strict=True))
    )


class _Field(NamedTuple):
    """Places (n, 2) over a camera's picture, which of them have a ray, two distances, and the
    points there (2, n, 3) in the rig's frame."""

    uv_px: Float[np.ndarray, "n 2"]
    has_ray: Bool[np.ndarray, "n"]
    distance_mm: Float[np.ndarray, "2"]
    points: Float[np.ndarray, "2 n 3"]


def _image_field(problem: Problem, camera: int) -> _Field:
    own = [view for view in problem.views if view.camera == camera]
    sides = own[0].detection.image_size_px
    # The middles of equal parts of the picture, row by row.
    u, v = ((np.arange(MAP_PLACES) + 0.5) * side / MAP_PLACES - 0.5 for side in sides)
    uv_px = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    lens = lens_number(problem, int(problem.parametrization.lens_of_camera[camera]))
    rays, boards = unproject_pixels(lens, uv_px), list_boards(problem.target)
    back_px = project_points(IN_PLACE, lens, rays)
    middles = [
        np.append((board.centres_mm.min(axis=0) + board.centres_mm.max(axis=0)) / 2, 0.0)
        for board in boards
    ]
    away = [
        np.linalg.norm(cam_from_board(problem.state, view).transform(middles[view.board]))
        for view in own
        if view.used.any()
    ]
    distance_mm = float(np.median(away)) * np.array([1.0, problem.tuning.advice.farther])
    rig_from_cam = Pose(np.asarray(problem.state.cam_from_rig)[camera]).inverse
    points = np.asarray(rig_from_cam.transform_points(distance_mm[:, None, None] * rays))
    return _Field(uv_px, np.linalg.norm(back_px - uv_px, axis=-1) < _SAME_PX, distance_mm, points)


@kept_jit
def _derivatives(
    state: RigState, parametrization: Parametrization, points: ArrayLike
) -> tuple[Array, Array]:
    """Of the images (c, 2, n, 2) of each camera's points, by a motion of them all and by steps of
    the head."""
    still = jnp.zeros((state.rig_from_board.shape[0], POSE_SIZE))

    def images(motion: Array, head: Array) -> ArrayLike:
        return _images(
            retract(state, parametrization, head, still),
            parametrization,
            _move(points, motion, parametrization),
        )

    zeros = jnp.zeros(POSE_SIZE), jnp.zeros(parametrization.free.shape[0])
    return jax.jacfwd(images, argnums=(0, 1))(*zeros)


def _images(state: RigState, parametrization: Parametrization, points: ArrayLike) -> ArrayLike:
    """Where each camera images its points (c, 2, n, 3), in px."""

    def of_camera(pose: ArrayLike, number: ArrayLike, own: ArrayLike) -> ArrayLike:
        lens = jax.tree.map(lambda leaf: leaf[number], state.lenses)
        return jax.vmap(jax.vmap(lambda point: project_point(Pose(pose), lens, point)))(own)

    return jax.vmap(of_camera)(
        jnp.asarray(state.cam_from_rig),
        jnp.asarray(parametrization.lens_of_camera),
        jnp.asarray(points),
    )


def _move(points: ArrayLike, step: ArrayLike, parametrization: Parametrization) -> ArrayLike:
    """All points after one rigid motion."""
    motion = Pose(step_motion(jnp.eye(3, 4), step, parametrization.unit_mm))
    return jax.vmap(motion.transform)(points.reshape(-1, 3)).reshape(points.shape)


_jitted_images, _jitted_move = kept_jit(_images), kept_jit(_move)


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


def _align_half(
    half: RigState,
    parametrization: Parametrization,
    points: Float[np.ndarray, "c 2 n 3"],
    seen_px: Float[np.ndarray, "r"],
    known: Bool[np.ndarray, "c 2 n 2"],
    along: Float[np.ndarray, "6 r"],
) -> Float[np.ndarray, "r"]:
    """Where a half images the points once it is moved to where these are."""
    for _ in range(_MOVES):
        off = np.asarray(_jitted_images(half, parametrization, points))[known] - seen_px
        points = np.asarray(_jitted_move(points, -(along @ off), parametrization))
    return np.asarray(_jitted_images(half, parametrization, points))[known]
