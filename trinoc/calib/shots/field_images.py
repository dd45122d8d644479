"""Points over the fields of all cameras, where these image them, and how that changes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from trinoc.calib.problem.variables import POSE_SIZE, Chart, RigState, step_motion
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# A place that a lens does not give back after so much has no ray.
_SAME_PX = 1e-3


@eqx.filter_jit
def points_seen(
    state: RigState, chart: Chart, uv_px: ArrayLike, distance_mm: ArrayLike
) -> tuple[Array, Array]:
    """Points (c, 2, n, 3) in the rig's frame that are imaged there, and where there are any."""

    def of_camera(pose: Array, lens: Array, places: Array, far_mm: Array) -> tuple[Array, Array]:
        own = jax.tree.map(lambda leaf: jnp.asarray(leaf)[lens], state.lenses)
        rays = jax.vmap(own.unproject)(places)
        off = jnp.linalg.norm(jax.vmap(own.project_ray)(rays) - places, axis=-1)

        def point(far: Array, ray: Array) -> Array:
            return pose[:, :3].T @ (far * ray / jnp.linalg.norm(ray) - pose[:, 3])

        points = jax.vmap(jax.vmap(point, (None, 0)), (0, None))(far_mm, rays)
        return points, off < _SAME_PX

    return jax.vmap(of_camera)(
        jnp.asarray(state.cam_from_rig),
        jnp.asarray(chart.lens_of_camera),
        jnp.asarray(uv_px),
        jnp.asarray(distance_mm),
    )


@eqx.filter_jit
def images_px(state: RigState, chart: Chart, points: ArrayLike) -> ArrayLike:
    """Where each camera images its points, (c, 2, n, 2) px."""

    def of_camera(pose: Array, lens: Array, own: ArrayLike) -> ArrayLike:
        return _image(jax.tree.map(lambda leaf: jnp.asarray(leaf)[lens], state.lenses), pose, own)

    return jax.vmap(of_camera)(
        jnp.asarray(state.cam_from_rig), jnp.asarray(chart.lens_of_camera), points
    )


def _image(lens: AbstractLens, pose: ArrayLike, points: ArrayLike) -> ArrayLike:
    image = partial(_image_of_point, lens, pose)
    return jax.vmap(jax.vmap(image))(points)


def _image_of_point(lens: AbstractLens, pose: ArrayLike, point: ArrayLike) -> ArrayLike:
    return lens.project_ray(pose[:, :3] @ point + pose[:, 3])


@eqx.filter_jit
def image_derivatives(state: RigState, chart: Chart, points: ArrayLike) -> tuple[Array, Array]:
    """Of the images by steps of each camera's lens and pose, and by a motion of all points."""
    _, size = chart.lens_shape

    def of_camera(pose: Array, lens: Array, own: ArrayLike) -> tuple[Array, Array]:
        here = jax.tree.map(lambda leaf: jnp.asarray(leaf)[lens], state.lenses)
        basis = jnp.asarray(chart.lens_basis)[lens]

        def after(step: Array, motion: Array) -> ArrayLike:
            changed = here.retract(basis @ step[:size])
            place = step_motion(jnp.eye(3, 4), motion, chart.unit_mm)
            turned = jax.vmap(jax.vmap(lambda point: place[:, :3] @ point + place[:, 3]))(own)
            return _image(changed, step_motion(pose, step[size:], chart.unit_mm), turned)

        zero = jnp.zeros(size + POSE_SIZE, basis.dtype), jnp.zeros(POSE_SIZE, basis.dtype)
        return jax.jacfwd(after, argnums=(0, 1))(*zero)

    return jax.vmap(of_camera)(
        jnp.asarray(state.cam_from_rig), jnp.asarray(chart.lens_of_camera), points
    )
