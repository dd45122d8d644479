"""Difference between the pixels that two rigs predict for the same points, over each image.

The rigs were fitted to two halves of the shots and have different frames. One rigid motion of all
cameras aligns both frames as well as possible, over all images at the distance of the boards. The
remaining difference does not depend on the frames. Source: mrcal, "Differences in projections" of
its documentation.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.problem.problem import Problem, cam_from_board, lens_of_index
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
from trinoc.calib.uncertainty.propagation import MAP_SIZE
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_point, project_points, unproject_pixels
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: rounds for convergence of the weights and of the motion.
_ALIGNMENTS, _MOVES = 2, 5
# numerical: a pixel has no ray if its ray projects farther away than this.
_SAME_PX = 1e-3


def field_differences(
    problem: Problem,
    halves: Sequence[RigState],
    covariance: Float[np.ndarray, "f f"],
    cameras: tuple[str, ...],
) -> tuple[FieldDifference, ...]:
    """For each camera, difference between the pixels that the rigs of two halves of the shots
    predict.

    It is evaluated for 3-D points on the rays of a grid of pixels. One rigid motion is removed,
    since the two rigs may have different frames.

    Parameters
    ----------
    problem : problem at the solution for all shots.
    halves : solutions for the two halves.
    covariance : (f, f) covariance of the difference of both solutions, for the estimated parameters
        of lenses, cameras and board.
    cameras : names of the cameras.
    """
    fields = [_image_field(problem, k) for k in range(len(cameras))]
    points = np.stack([field.points for field in fields])
    by_motion, by_parameters = _derivatives(problem.state, problem.parametrization, points)
    shape = np.shape(by_motion)[:-1]
    has_ray = np.stack([field.has_ray for field in fields])
    has_ray = np.broadcast_to(has_ray[:, None, :, None], shape)
    at_boards = np.broadcast_to((np.arange(2) == 0)[:, None, None], shape)[has_ray]
    free = np.flatnonzero(problem.free)
    alignment, jacobian = _alignment(
        np.asarray(by_motion)[has_ray],
        np.asarray(by_parameters)[has_ray][:, free],
        covariance,
        at_boards,
    )
    reference_px = np.broadcast_to(np.stack([f.uv_px for f in fields])[:, None], shape)[has_ray]
    first, second = (
        _align_half(half, problem.parametrization, points, reference_px, has_ray, alignment)
        for half in halves
    )
    difference_px, variance = np.full(shape, np.nan), np.full(shape, np.nan)
    difference_px[has_ray] = first - second
    variance[has_ray] = np.einsum("rf,fg,rg->r", jacobian, covariance, jacobian)
    sigma_px = np.sqrt(variance.mean(axis=-1))
    return tuple(
        FieldDifference(name, field.distance_mm, field.uv_px, difference_px[k], sigma_px[k])
        for k, (name, field) in enumerate(zip(cameras, fields, strict=True))
    )


class _Field(NamedTuple):
    """Grid of n pixels in one camera's image, and 3-D points on their rays.

    Attributes
    ----------
    uv_px : (n, 2) pixels of the grid.
    has_ray : (n,) whether the lens has a ray for the pixel.
    distance_mm : (2,) distances of the points from the camera.
    points : (2, n, 3) points at each distance, in the frame of the rig, mm.
    """

    uv_px: Float[np.ndarray, "n 2"]
    has_ray: Bool[np.ndarray, "n"]
    distance_mm: Float[np.ndarray, "2"]
    points: Float[np.ndarray, "2 n 3"]


def _image_field(problem: Problem, camera: int) -> _Field:
    camera_views = [view for view in problem.views if view.camera == camera]
    sides = camera_views[0].detection.image_size_px
    # Centres of equal cells of the image, row by row.
    u, v = ((np.arange(MAP_SIZE) + 0.5) * side / MAP_SIZE - 0.5 for side in sides)
    uv_px = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    lens = lens_of_index(problem, int(problem.parametrization.lens_of_camera[camera]))
    rays, boards = unproject_pixels(lens, uv_px), list_boards(problem.target)
    back_px = project_points(IN_PLACE, lens, rays)
    middles = [
        np.append((board.centres_mm.min(axis=0) + board.centres_mm.max(axis=0)) / 2, 0.0)
        for board in boards
    ]
    distances_mm = [
        np.linalg.norm(cam_from_board(problem.state, view).transform(middles[view.board]))
        for view in camera_views
        if view.used.any()
    ]
    distance_mm = float(np.median(distances_mm)) * np.array([1.0, problem.tuning.advice.farther])
    rig_from_cam = Pose(np.asarray(problem.state.cam_from_rig)[camera]).inverse
    points = np.asarray(rig_from_cam.transform_points(distance_mm[:, None, None] * rays))
    return _Field(uv_px, np.linalg.norm(back_px - uv_px, axis=-1) < _SAME_PX, distance_mm, points)


@kept_jit
def _derivatives(
    state: RigState, parametrization: Parametrization, points: ArrayLike
) -> tuple[Array, Array]:
    """Derivatives of the predicted pixels, (c, 2, n, 2), of n points at two distances from each of
    c cameras.

    The first is with respect to one rigid motion of all points, (6,). The second is with respect to
    lenses, cameras and board, (h,).
    """
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
    """Predicted pixels, (c, 2, n, 2), of n points at two distances from each of c cameras, (c, 2,
    n, 3).
    """

    def of_camera(pose: ArrayLike, lens_index: ArrayLike, camera_points: ArrayLike) -> ArrayLike:
        lens = jax.tree.map(lambda leaf: leaf[lens_index], state.lenses)
        return jax.vmap(jax.vmap(lambda point: project_point(Pose(pose), lens, point)))(
            camera_points
        )

    return jax.vmap(of_camera)(
        jnp.asarray(state.cam_from_rig),
        jnp.asarray(parametrization.lens_of_camera),
        jnp.asarray(points),
    )


def _move(points: ArrayLike, step: ArrayLike, parametrization: Parametrization) -> ArrayLike:
    """Apply one rigid motion, (6,) in local coordinates, to all points."""
    motion = Pose(step_motion(jnp.eye(3, 4), step, parametrization.unit_mm))
    return jax.vmap(motion.transform)(points.reshape(-1, 3)).reshape(points.shape)


_jitted_images, _jitted_move = kept_jit(_images), kept_jit(_move)


def _alignment(
    by_rig: Float[np.ndarray, "r 6"],
    by_parameters: Float[np.ndarray, "r f"],
    covariance: Float[np.ndarray, "f f"],
    has_weight: Bool[np.ndarray, "r"],
) -> tuple[Float[np.ndarray, "6 r"], Float[np.ndarray, "r f"]]:
    """Weighted least-squares map from pixel differences to the rigid motion that explains most of
    them.

    Returns this map, (6, r), and the derivatives `by_parameters` with this motion removed, (r, f).
    The weights are inverse variances, computed in a second round.

    Parameters
    ----------
    by_rig : (r, 6) derivative of r pixel coordinates with respect to a rigid motion of all points.
    by_parameters : (r, f) derivative of these coordinates with respect to the estimated parameters.
    covariance : (f, f) covariance of these parameters.
    has_weight : (r,) whether a coordinate is used.
    """
    weight, alignment, reduced = has_weight.astype(float), np.zeros_like(by_rig.T), by_parameters
    for _ in range(_ALIGNMENTS):
        weighted = weight[:, None] * by_rig
        alignment = np.linalg.solve(weighted.T @ by_rig, weighted.T)
        reduced = by_parameters - by_rig @ (alignment @ by_parameters)
        variance = np.einsum("rf,fg,rg->r", reduced, covariance, reduced)
        weight = has_weight / np.maximum(variance, 1e-300)
    return alignment, reduced


def _align_half(
    half: RigState,
    parametrization: Parametrization,
    points: Float[np.ndarray, "c 2 n 3"],
    reference_px: Float[np.ndarray, "r"],
    has_ray: Bool[np.ndarray, "c 2 n 2"],
    alignment: Float[np.ndarray, "6 r"],
) -> Float[np.ndarray, "r"]:
    """Pixels predicted by the rig of one half of the shots, after alignment with the common rig,
    (r,).

    Parameters
    ----------
    half : solution for the half.
    points : (c, 2, n, 3) n points at two distances from each camera, on its rays, mm.
    reference_px : (r,) pixel coordinates predicted by the rig of all shots.
    has_ray : mask of the pixel coordinates for which the lens has a ray; r of them are True.
    alignment : (6, r) map from pixel differences to the rigid motion that explains most of them.
    """
    for _ in range(_MOVES):
        difference_px = (
            np.asarray(_jitted_images(half, parametrization, points))[has_ray] - reference_px
        )
        points = np.asarray(_jitted_move(points, -(alignment @ difference_px), parametrization))
    return np.asarray(_jitted_images(half, parametrization, points))[has_ray]
