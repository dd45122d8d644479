"""Propagation of camera errors to pixels, epipolar lines and points."""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera, sheet_from_pixel
from trinoc.geometry.epipolar import epipolar_distance_px, fundamental_matrix
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.projection import (
    project_by_matrix,
    project_point,
    project_points,
    unproject_pixels,
)
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.geometry.triangulation import triangulate_point
from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.programs import kept_jit

# numerical: positions along each side of the image, in maps for users.
MAP_SIZE = 5
# numerical: a pixel has no ray if its ray projects farther away than this.
_SAME_PX = 1e-3
# Parameters of one camera: its pose, then its lens without distortion.
_NAMES = PARAMETER_NAMES + AFFINE_PARAMETERS
# numerical: units.
_TO_RADIANS = np.array([*np.full(3, np.pi / 180), *np.ones(len(_NAMES) - 3)])


class FieldSigma(NamedTuple):
    """Standard deviation of an image quantity at n positions in the image of a camera.

    The quantity depends on the function that returns the result: the distance from an epipolar
    line, or the position of a pixel.

    Attributes
    ----------
    uv_px : (n, 2) positions in the image.
    sigma_px : (n,) standard deviation of the quantity at each position.
    """

    uv_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n"]


@in_float64
def epipolar_sigma(rig: Rig, first: str, second: str) -> FieldSigma:
    """Standard deviation of epipolar lines, over the image of the first camera.

    The ray of each position in the first image meets the plane of the sheet at a point, which is
    projected into the second image. The result is the standard deviation of the distance between
    this projection and the epipolar line of the position, in undistorted pixels. Errors of focal
    lengths and principal points, and their correlation with the pose, are included if the rig's
    covariance contains them.

    Parameters
    ----------
    rig : rig with a covariance.
    first, second : names of the cameras.

    Raises
    ------
    InputError : the rig has no covariance.
    """
    covariance, values = _camera_covariance(rig, (first, second))
    lens = rig[first].intrinsics
    pixels = field_grid_px(lens.image_size_px).reshape(-1, 2)
    matrices = np.stack([np.asarray(rig[name].intrinsics.matrix) for name in (first, second)])
    ideal = Camera(Intrinsics.from_matrix(lens.matrix, lens.image_size_px), rig[first].pose)
    jacobian = np.asarray(_distances_by_change(values, matrices, ideal, pixels)).reshape(
        len(pixels), -1
    )
    return FieldSigma(pixels, np.sqrt(np.einsum("np,pq,nq->n", jacobian, covariance, jacobian)))


@kept_jit
def _distances_by_change(
    values: Float[ArrayLike, "2 p"],
    matrices: Float[ArrayLike, "2 3 3"],
    first: Camera,
    pixels: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n 2 p"]:
    """Derivatives of the distances from the epipolar lines, (n, 2, p).

    They are with respect to the parameters of both cameras.

    values : (2, p) pose, focal lengths and principal point of each camera.
    matrices : (2, 3, 3) camera matrices.
    """
    points = jax.vmap(sheet_from_pixel, (None, 0))(first, pixels)
    projections = _projections(values, matrices)

    def distances(change: Float[ArrayLike, "2 p"]) -> Float[ArrayLike, "n"]:
        moved = _projections(values + change, matrices)
        fundamental = fundamental_matrix(moved[1], moved[0])

        def distance(uv: Float[ArrayLike, "2"], point: Float[ArrayLike, "2"]) -> ArrayLike:
            image = project_by_matrix(projections[1], jnp.append(point, 0.0))
            return epipolar_distance_px(fundamental, image, uv)

        return jax.vmap(distance)(pixels, points)

    return jax.jacfwd(distances)(jnp.zeros_like(values))


@in_float64
def point_covariance(rig: Rig, point_mm: Float[ArrayLike, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Covariance, mm^2, of points triangulated by all cameras from exact pixels.

    Errors of the lenses are included as in `epipolar_sigma`. Errors of the pixels are not included.

    Parameters
    ----------
    rig : rig with a covariance.
    point_mm : (*n, 3) one point or many points in the world.

    Returns
    -------
    (*n, 3, 3) covariance of each point.

    Raises
    ------
    InputError : the rig has no covariance.
    """
    covariance, values = _camera_covariance(rig, rig.names)
    matrices = np.stack([np.asarray(camera.intrinsics.matrix) for _, camera in rig.items()])
    points = np.asarray(point_mm, float)
    jacobian = np.asarray(_points_by_change(values, matrices, points.reshape(-1, 3)))
    jacobian = jacobian.reshape(*points.shape, -1)
    return jacobian @ covariance @ np.swapaxes(jacobian, -1, -2)


@kept_jit
def _points_by_change(
    values: Float[ArrayLike, "v p"],
    matrices: Float[ArrayLike, "v 3 3"],
    points_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 3 v p"]:
    """Derivatives of triangulated points, (n, 3, v, p), with respect to the cameras' parameters.

    The points are triangulated from exact pixels.

    values : (v, p) pose, focal lengths and principal point of each camera.
    matrices : (v, 3, 3) camera matrices.
    """
    pixels = project_by_matrix(_projections(values, matrices), points_mm[None])
    weight = jnp.ones(len(values))

    def triangulated(change: Float[ArrayLike, "v p"]) -> Float[ArrayLike, "n 3"]:
        moved = _projections(values + change, matrices)
        return jax.vmap(lambda view_pixels: triangulate_point(moved, view_pixels, weight), 1)(
            pixels
        )

    return jax.jacfwd(triangulated)(jnp.zeros_like(values))


def _camera_covariance(
    rig: Rig, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "v p"]]:
    """Covariance and values of the poses, focal lengths and principal points of cameras.

    The units are rad, mm and px. A parameter that is not in the rig's covariance has zero variance.
    """
    _expect_covariance(rig)
    covariance = rig.covariance_of(
        [f"{name}.{parameter}" for name in names for parameter in _NAMES]
    )
    scale = np.tile(_TO_RADIANS, len(names))
    values = [
        [*camera.pose.parameters, *camera.intrinsics.lens.parameters[: len(AFFINE_PARAMETERS)]]
        for camera in map(rig.__getitem__, names)
    ]
    return covariance * np.outer(scale, scale), np.array(values)


def _expect_covariance(rig: Rig) -> None:
    if not rig.parameters:
        raise InputError(
            "This rig has no covariance: calibrate the rig, or load a rig that has a covariance."
        )


def _projections(
    values: Float[ArrayLike, "v p"], matrices: Float[ArrayLike, "v 3 3"]
) -> Float[ArrayLike, "v 3 4"]:
    """Projection matrices, (v, 3, 4), for given poses, focal lengths and principal points.

    values : (v, p) pose, focal lengths and principal point of each camera.
    matrices : (v, 3, 3) camera matrices, from which the skew is used.
    """

    def projection(vector: Float[ArrayLike, "p"], matrix: Float[ArrayLike, "3 3"]) -> ArrayLike:
        pose, (fu, fv, cu, cv) = vector[: len(PARAMETER_NAMES)], vector[len(PARAMETER_NAMES) :]
        affine = jnp.asarray(matrix).at[(0, 1, 0, 1), (0, 1, 2, 2)].set(jnp.stack([fu, fv, cu, cv]))
        return affine @ Pose.from_parameters(pose).cam_from_world

    return jax.vmap(projection)(values, matrices)


@in_float64
def projection_sigma(rig: Rig, camera: str, distance_mm: float) -> FieldSigma:
    """Standard deviation per axis of the pixels of fixed points, over the image of a camera.

    The points lie on the rays of a grid of pixels, at one distance. Errors of lens and pose
    compensate each other at the distance of the board, and compensate less at other distances.

    Parameters
    ----------
    rig : rig with a covariance.
    camera : name of the camera.
    distance_mm : distance of the points from the camera.

    Returns
    -------
    Pixels of the grid, and their standard deviations; NaN where the lens images no ray, such as
    beyond the image circle of a fisheye.

    Raises
    ------
    InputError : the rig has no covariance, or the distance is not positive.
    """
    if not distance_mm > 0:
        raise InputError(f"distance_mm is {distance_mm}, but must be positive.")
    _expect_covariance(rig)
    camera_model = rig[camera]
    lens = promote_lens(camera_model.intrinsics.lens)
    model = PoseModel.AIM_FREE
    if f"{camera}.{PoseModel.RIGID.parameter_names[0]}" in rig.parameters:
        model = PoseModel.RIGID
    names = [f"{camera}.{name}" for name in (*model.parameter_names, *lens.parameter_names)]
    pixels = field_grid_px(camera_model.image_size_px).reshape(-1, 2)
    jacobian = np.asarray(
        _by_parameters(camera_model.pose, lens, pixels, np.asarray(distance_mm), model)
    )
    variance = np.einsum("nip,pq,niq->n", jacobian, rig.covariance_of(names), jacobian) / 2
    back_px = project_points(Pose(np.eye(3, 4)), lens, unproject_pixels(lens, pixels))
    has_ray = np.linalg.norm(back_px - pixels, axis=1) < _SAME_PX
    return FieldSigma(pixels, np.where(has_ray, np.sqrt(np.maximum(variance, 0.0)), np.nan))


def field_grid_px(image_size_px: tuple[int, int]) -> Float[np.ndarray, "5 5 2"]:
    """Pixels of a 5 x 5 grid from corner to corner of the image, row by row from the top.

    Parameters
    ----------
    image_size_px : (width, height) of the image.
    """
    u, v = (np.linspace(0.0, side - 1.0, MAP_SIZE) for side in image_size_px)
    return np.stack(np.meshgrid(u, v), axis=-1)


@functools.partial(kept_jit, static_argnames=("model",))
def _by_parameters(
    pose: Pose,
    lens: AbstractLens,
    grid_px: Float[ArrayLike, "n 2"],
    distance_mm: Float[ArrayLike, ""],
    model: PoseModel,
) -> Array:
    """Derivatives of the pixels of fixed points with respect to pose and lens, (n, 2, p).

    The points lie on the rays of `grid_px`, at the distance `distance_mm`. The units of the pose
    are degrees and mm.
    """
    rays = jax.vmap(lens.unproject)(grid_px)
    rotation, centre = jnp.asarray(pose.rotation), pose.centre_world_mm
    points = centre[None] + distance_mm * (rays @ rotation)

    def pixels(change: Float[ArrayLike, "p"]) -> Float[ArrayLike, "n 2"]:
        pose_step = jnp.concatenate([jnp.radians(change[:3]), change[3:6]])
        if model is PoseModel.RIGID:
            moved = pose.retract(pose_step, model, 1.0)
        else:
            moved = Pose.from_parameters(pose.parameters + pose_step)
        changed = lens.with_parameters(lens.parameters + change[6:])
        return jax.vmap(lambda point: project_point(moved, changed, point))(points)

    return jax.jacfwd(pixels)(jnp.zeros(6 + len(lens.parameter_names)))


@kept_jit
def field_sigma_px(
    lens: AbstractLens,
    covariance: Float[ArrayLike, "q q"],
    grid_px: Float[ArrayLike, "5 5 2"],
) -> Float[Array, "5 5"]:
    """Standard deviation per axis of the pixel at which a lens images a fixed ray, (5, 5).

    The part of the errors that equals a rotation of the camera is removed, because a calibration of
    the pose compensates it. NaN where the lens images no ray.

    Parameters
    ----------
    lens : the lens.
    covariance : (q, q) covariance of its parameters.
    grid_px : (5, 5, 2) pixels of the rays.
    """
    rays = jax.vmap(lens.unproject)(grid_px.reshape(-1, 2))
    errors_px = jax.vmap(lens.project_ray)(rays) - grid_px.reshape(-1, 2)
    has_ray = jnp.repeat(jnp.sum(errors_px * errors_px, axis=1) < _SAME_PX * _SAME_PX, 2)

    def pixel(
        values: Float[Array, "q"], turn: Float[Array, "3"], ray: Float[Array, "3"]
    ) -> Float[ArrayLike, "2"]:
        return lens.with_parameters(values).project_ray(rotation_from_vector(turn) @ ray)

    values, no_turn = jnp.asarray(lens.parameters), jnp.zeros(3, rays.dtype)
    jacobian = jax.vmap(jax.jacfwd(pixel, argnums=(0, 1)), in_axes=(None, None, 0))
    by_lens, by_turn = jacobian(values, no_turn, rays)
    by_lens, by_turn = (
        jnp.where(has_ray[:, None], by.reshape(2 * len(rays), -1), 0.0) for by in (by_lens, by_turn)
    )
    turn_of_lens = jnp.linalg.solve(by_turn.T @ by_turn, by_turn.T @ by_lens)
    remaining = by_lens - by_turn @ turn_of_lens
    variance = jnp.einsum("iq,qr,ir->i", remaining, covariance, remaining)
    variance = jnp.where(has_ray, variance, jnp.nan)
    return jnp.sqrt(jnp.mean(variance.reshape(MAP_SIZE, MAP_SIZE, 2), axis=2))
