"""How well a rig, or a lens alone, knows where it images a point: mrcal's question."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.errors import InputError
from trinoc.geometry import (
    AbstractLens,
    Pose,
    PoseModel,
    Rig,
    project_point,
    promoted,
    rotation_from_vector,
)
from trinoc.numerics import ArrayLike, in_float64

# Places across the picture, along each side.
_PLACES = 5


class ProjectionSigma(NamedTuple):
    """Standard deviation of where a camera images points that the world holds fixed.

    Fields
    ------
    uv_px : (n, 2) places in the picture.
    sigma_px : (n,) per axis, by the errors of lens and pose together.
    """

    uv_px: Float[np.ndarray, "n 2"]
    sigma_px: Float[np.ndarray, "n"]


@in_float64
def projection_sigma(rig: Rig, camera: str, distance_mm: float) -> ProjectionSigma:
    """Over the field of a camera, for points at a distance from it along each pixel's ray.

    Errors of lens and pose compensate each other where the board was, and no longer do so much
    nearer or farther: that is what this tells. Raises InputError for a rig without a covariance,
    or a distance that is not positive.
    """
    if not distance_mm > 0:
        raise InputError(f"distance_mm is {distance_mm}, but must be positive.")
    view = rig[camera]
    lens = promoted(view.intrinsics.lens)
    if not rig.parameters:
        raise InputError("This rig holds no covariance: calibrate it, or load one that does.")
    model = PoseModel.AIM_FREE
    if f"{camera}.{PoseModel.RIGID.parameter_names[0]}" in rig.parameters:
        model = PoseModel.RIGID
    names = [f"{camera}.{name}" for name in (*model.parameter_names, *lens.parameter_names)]
    known = [name in rig.parameters for name in names]
    rows = [rig.parameters.index(name) if name in rig.parameters else 0 for name in names]
    given = np.outer(known, known) * np.asarray(rig.covariance)[np.ix_(rows, rows)]
    places = field_places_px(view.image_size_px).reshape(-1, 2)
    by = np.asarray(_by_parameters(view.pose, lens, places, np.asarray(distance_mm), model))
    variance = np.einsum("nip,pq,niq->n", by, given, by) / 2
    return ProjectionSigma(places, np.sqrt(np.maximum(variance, 0.0)))


def field_places_px(image_size_px: tuple[int, int]) -> Float[np.ndarray, "5 5 2"]:
    """Places from corner to corner of the picture, row by row from the top."""
    u, v = (np.linspace(0.0, side - 1.0, _PLACES) for side in image_size_px)
    return np.stack(np.meshgrid(u, v), axis=-1)


def _by_parameters(
    pose: Pose,
    lens: AbstractLens,
    places: Float[np.ndarray, "n 2"],
    distance_mm: Float[np.ndarray, ""],
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


@jax.jit
def field_sigma_px(
    lens: AbstractLens,
    covariance: Float[ArrayLike, "q q"],
    places_px: Float[ArrayLike, "5 5 2"],
) -> Float[Array, "5 5"]:
    """Standard deviation, per axis, of where the lens images a given ray.

    A turn of the camera that all places share is taken out: whoever poses the camera finds
    it again, and a principal point that is off looks like one.
    """
    rays = jax.vmap(lens.unproject)(places_px.reshape(-1, 2))

    def pixel(
        values: Float[Array, "q"], turn: Float[Array, "3"], ray: Float[Array, "3"]
    ) -> Float[ArrayLike, "2"]:
        return lens.with_parameters(values).project_ray(rotation_from_vector(turn) @ ray)

    values, still = jnp.asarray(lens.parameters), jnp.zeros(3, rays.dtype)
    by_lens = jax.vmap(jax.jacfwd(pixel), in_axes=(None, None, 0))(values, still, rays)
    by_turn = jax.vmap(jax.jacfwd(pixel, argnums=1), in_axes=(None, None, 0))(values, still, rays)
    by_lens, by_turn = by_lens.reshape(-1, len(values)), by_turn.reshape(-1, 3)
    turn_of_lens = jnp.linalg.solve(by_turn.T @ by_turn, by_turn.T @ by_lens)
    remaining = by_lens - by_turn @ turn_of_lens
    variance = jnp.einsum("iq,qr,ir->i", remaining, covariance, remaining)
    return jnp.sqrt(jnp.mean(variance.reshape(_PLACES, _PLACES, 2), axis=2))
