"""What the cameras' errors do to what people use a rig for: pixels, epipolar lines and points."""

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

# numerical: places across the picture, along each side, of maps for people.
MAP_PLACES = 5
# numerical: a place that a lens does not give back after so much has no ray.
_SAME_PX = 1e-3
# Of one camera: its pose, then its lens without distortion.
_NAMES = PARAMETER_NAMES + AFFINE_PARAMETERS
# numerical: units.
_TO_RADIANS = np.array([*np.full(3, np.pi / 180), *np.ones(len(_NAMES) - 3)])


class FieldSigma(NamedTuple):
    """How well something is known over the field of a camera.

    Fields
    ------
    uv_px : (n, 2) places in the picture.
    sigma_px : (n,) standard deviation at each.
    """

    uv_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n"]


@in_float64
def epipolar_sigma(rig: Rig, first: str, second: str) -> FieldSigma:
    """How well the rig knows its epipolar lines, over the field of the first picture.

    The sigma is that of the distance, in the second picture, of the point of the sheet's plane that
    is seen in the first at each place, from its epipolar line.
    Where the rig's covariance holds focal lengths and principal points, their errors are in, with
    those of the pose that go with them. Undistorted pixels. Raises InputError for a rig without a
    covariance.
    """
    covariance, values = _known_covariance(rig, (first, second))
    lens = rig[first].intrinsics
    places = field_places_px(lens.image_size_px).reshape(-1, 2)
    matrices = np.stack([np.asarray(rig[name].intrinsics.matrix) for name in (first, second)])
    ideal = Camera(Intrinsics.from_matrix(lens.matrix, lens.image_size_px), rig[first].pose)
    by = np.asarray(_distances_by_change(values, matrices, ideal, places)).reshape(len(places), -1)
    return FieldSigma(places, np.sqrt(np.einsum("np,pq,nq->n", by, covariance, by)))


@kept_jit
def _distances_by_change(
    values: Float[ArrayLike, "2 p"],
    matrices: Float[ArrayLike, "2 3 3"],
    first: Camera,
    places: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n 2 p"]:
    """Derivatives of the distances from the epipolar lines by the parameters of both cameras."""
    points = jax.vmap(sheet_from_pixel, (None, 0))(first, places)
    there = _projections(values, matrices)

    def distances(change: Float[ArrayLike, "2 p"]) -> Float[ArrayLike, "n"]:
        moved = _projections(values + change, matrices)
        fundamental = fundamental_matrix(moved[1], moved[0])

        def distance(uv: Float[ArrayLike, "2"], point: Float[ArrayLike, "2"]) -> ArrayLike:
            image = project_by_matrix(there[1], jnp.append(point, 0.0))
            return epipolar_distance_px(fundamental, image, uv)

        return jax.vmap(distance)(places, points)

    return jax.jacfwd(distances)(jnp.zeros_like(values))


@in_float64
def point_covariance(rig: Rig, point_mm: Float[ArrayLike, "*n 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """Covariance, mm^2, of a point triangulated by all cameras from exact images; of each, of many.

    The errors of the lenses are in, as in `epipolar_sigma`; that of the images comes on top. Raises
    InputError for a rig without a covariance.
    """
    covariance, values = _known_covariance(rig, rig.names)
    matrices = np.stack([np.asarray(camera.intrinsics.matrix) for _, camera in rig.items()])
    points = np.asarray(point_mm, float)
    by = np.asarray(_places_by_change(values, matrices, points.reshape(-1, 3)))
    by = by.reshape(*points.shape, -1)
    return by @ covariance @ np.swapaxes(by, -1, -2)


@kept_jit
def _places_by_change(
    values: Float[ArrayLike, "v p"],
    matrices: Float[ArrayLike, "v 3 3"],
    points_mm: Float[ArrayLike, "n 3"],
) -> Float[ArrayLike, "n 3 v p"]:
    """Derivatives of the places triangulated from exact images by the cameras' parameters."""
    seen = project_by_matrix(_projections(values, matrices), points_mm[None])
    weight = jnp.ones(len(values))

    def places(change: Float[ArrayLike, "v p"]) -> Float[ArrayLike, "n 3"]:
        moved = _projections(values + change, matrices)
        return jax.vmap(lambda own: triangulate_point(moved, own, weight), 1)(seen)

    return jax.jacfwd(places)(jnp.zeros_like(values))


def _known_covariance(
    rig: Rig, names: tuple[str, ...]
) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, "v p"]]:
    """Covariance, in rad, mm and px, and values of pose and lens; absent ones are exact."""
    _expect_covariance(rig)
    covariance = rig.covariance_of([f"{name}.{own}" for name in names for own in _NAMES])
    scale = np.tile(_TO_RADIANS, len(names))
    values = [
        [*camera.pose.parameters, *camera.intrinsics.lens.parameters[: len(AFFINE_PARAMETERS)]]
        for camera in map(rig.__getitem__, names)
    ]
    return covariance * np.outer(scale, scale), np.array(values)


def _expect_covariance(rig: Rig) -> None:
    if not rig.parameters:
        raise InputError("This rig holds no covariance: calibrate it, or load one that does.")


def _projections(
    values: Float[ArrayLike, "v p"], matrices: Float[ArrayLike, "v 3 3"]
) -> Float[ArrayLike, "v 3 4"]:
    """Of cameras with these poses, focal lengths and principal points; `matrices` hold the skew."""

    def projection(vector: Float[ArrayLike, "p"], matrix: Float[ArrayLike, "3 3"]) -> ArrayLike:
        pose, (fu, fv, cu, cv) = vector[: len(PARAMETER_NAMES)], vector[len(PARAMETER_NAMES) :]
        affine = jnp.asarray(matrix).at[(0, 1, 0, 1), (0, 1, 2, 2)].set(jnp.stack([fu, fv, cu, cv]))
        return affine @ Pose.from_parameters(pose).cam_from_world

    return jax.vmap(projection)(values, matrices)


@in_float64
def projection_sigma(rig: Rig, camera: str, distance_mm: float) -> FieldSigma:
    """How well a camera knows where it images points that the world holds fixed, per axis.

    They are over its field, at a distance from it along each pixel's ray.
    Errors of lens and pose compensate each other where the board was, and no longer do so much
    nearer or farther: that is what this tells. NaN where the lens images no ray, as beyond the
    image circle of a fisheye. Raises InputError for a rig without a covariance, or a distance that
    is not positive.
    """
    if not distance_mm > 0:
        raise InputError(f"distance_mm is {distance_mm}, but must be positive.")
    _expect_covariance(rig)
    view = rig[camera]
    lens = promote_lens(view.intrinsics.lens)
    model = PoseModel.AIM_FREE
    if f"{camera}.{PoseModel.RIGID.parameter_names[0]}" in rig.parameters:
        model = PoseModel.RIGID
    names = [f"{camera}.{name}" for name in (*model.parameter_names, *lens.parameter_names)]
    places = field_places_px(view.image_size_px).reshape(-1, 2)
    by = np.asarray(_by_parameters(view.pose, lens, places, np.asarray(distance_mm), model))
    variance = np.einsum("nip,pq,niq->n", by, rig.covariance_of(names), by) / 2
    back_px = project_points(Pose(np.eye(3, 4)), lens, unproject_pixels(lens, places))
    has_ray = np.linalg.norm(back_px - places, axis=1) < _SAME_PX
    return FieldSigma(places, np.where(has_ray, np.sqrt(np.maximum(variance, 0.0)), np.nan))


def field_places_px(image_size_px: tuple[int, int]) -> Float[np.ndarray, "5 5 2"]:
    """Places from corner to corner of the picture, row by row from the top."""
    u, v = (np.linspace(0.0, side - 1.0, MAP_PLACES) for side in image_size_px)
    return np.stack(np.meshgrid(u, v), axis=-1)


@functools.partial(kept_jit, static_argnames=("model",))
def _by_parameters(
    pose: Pose,
    lens: AbstractLens,
    places: Float[ArrayLike, "n 2"],
    distance_mm: Float[ArrayLike, ""],
    model: PoseModel,
) -> Array:
    """Derivative of the pixels of fixed points by pose (degrees, mm) and lens."""
    rays = jax.vmap(lens.unproject)(places)
    rotation, centre = jnp.asarray(pose.rotation), pose.centre_world_mm
    points = centre[None] + distance_mm * (rays @ rotation)

    def pixels(change: Float[ArrayLike, "p"]) -> Float[ArrayLike, "n 2"]:
        of_pose = jnp.concatenate([jnp.radians(change[:3]), change[3:6]])
        if model is PoseModel.RIGID:
            moved = pose.retract(of_pose, model, 1.0)
        else:
            moved = Pose.from_parameters(pose.parameters + of_pose)
        changed = lens.with_parameters(lens.parameters + change[6:])
        return jax.vmap(lambda point: project_point(moved, changed, point))(points)

    return jax.jacfwd(pixels)(jnp.zeros(6 + len(lens.parameter_names)))


@kept_jit
def field_sigma_px(
    lens: AbstractLens,
    covariance: Float[ArrayLike, "q q"],
    places_px: Float[ArrayLike, "5 5 2"],
) -> Float[Array, "5 5"]:
    """Standard deviation, per axis, of where the lens images a given ray.

    A turn of the camera that all places share is taken out: whoever poses the camera finds
    it again, and a principal point that is off looks like one. NaN where the lens images no ray.
    """
    rays = jax.vmap(lens.unproject)(places_px.reshape(-1, 2))
    misses_px = jax.vmap(lens.project_ray)(rays) - places_px.reshape(-1, 2)
    has_ray = jnp.repeat(jnp.sum(misses_px * misses_px, axis=1) < _SAME_PX * _SAME_PX, 2)

    def pixel(
        values: Float[Array, "q"], turn: Float[Array, "3"], ray: Float[Array, "3"]
    ) -> Float[ArrayLike, "2"]:
        return lens.with_parameters(values).project_ray(rotation_from_vector(turn) @ ray)

    values, still = jnp.asarray(lens.parameters), jnp.zeros(3, rays.dtype)
    by_both = jax.vmap(jax.jacfwd(pixel, argnums=(0, 1)), in_axes=(None, None, 0))
    by_lens, by_turn = by_both(values, still, rays)
    by_lens, by_turn = (
        jnp.where(has_ray[:, None], by.reshape(2 * len(rays), -1), 0.0) for by in (by_lens, by_turn)
    )
    turn_of_lens = jnp.linalg.solve(by_turn.T @ by_turn, by_turn.T @ by_lens)
    remaining = by_lens - by_turn @ turn_of_lens
    variance = jnp.einsum("iq,qr,ir->i", remaining, covariance, remaining)
    variance = jnp.where(has_ray, variance, jnp.nan)
    return jnp.sqrt(jnp.mean(variance.reshape(MAP_PLACES, MAP_PLACES, 2), axis=2))
