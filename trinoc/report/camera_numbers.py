"""What the page asks of cameras, each question compiled once for all cameras of a rig."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry import (
    Camera,
    image_of_circle_centre,
    project,
)
from trinoc.numerics import ArrayLike, bucket, in_float64, padded


@in_float64
def rays_of_pixels(camera: Camera, uv_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Unit rays in the camera's frame, whatever its lens."""
    return np.asarray(_rays(camera, _in_bucket(uv_px)))[: len(uv_px)]


@in_float64
def epipolar_planes(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Unit normals, in the frame of view b, of the planes of points of view a and both centres.

    A pixel of view b lies on the epipolar curve where its ray is square to the normal.
    """
    return np.asarray(_planes(camera_b, camera_a, _in_bucket(uv_a_px)))[: len(uv_a_px)]


@in_float64
def epipolar_distances_px(
    camera_b: Camera,
    camera_a: Camera,
    uv_b_px: Float[np.ndarray, "n 2"],
    uv_a_px: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n"]:
    """How far points of view b lie from the epipolar curves of their partners in view a."""
    distances = _distances_px(camera_b, camera_a, _in_bucket(uv_b_px), _in_bucket(uv_a_px))
    return np.asarray(distances)[: len(uv_b_px)]


@in_float64
def shift_of_circle_centres(
    camera: Camera, centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 2"]:
    """From the centre of each circle's image to the image of the circle's centre, in pixels."""
    return np.asarray(_centre_shifts(camera, centres_mm, radius_mm))


def _in_bucket(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    return padded(points, bucket(len(points)), points[-1] if len(points) else 0)


@eqx.filter_jit
def _rays(camera: Camera, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 3"]:
    return jax.vmap(camera.intrinsics.lens.unproject)(uv_px)


@eqx.filter_jit
def _planes(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    to_centre = camera_b.pose.rotation @ (
        camera_a.pose.centre_world_mm - camera_b.pose.centre_world_mm
    )
    turn = camera_b.pose.rotation @ camera_a.pose.rotation.T

    def normal(uv_px: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        across = jnp.cross(to_centre, turn @ camera_a.intrinsics.lens.unproject(uv_px))
        return across / jnp.linalg.norm(across)

    return jax.vmap(normal)(uv_a_px)


@eqx.filter_jit
def _distances_px(
    camera_b: Camera,
    camera_a: Camera,
    uv_b_px: Float[ArrayLike, "n 2"],
    uv_a_px: Float[ArrayLike, "n 2"],
) -> Float[ArrayLike, "n"]:
    def distance(
        normal: Float[ArrayLike, "3"], uv_px: Float[ArrayLike, "2"]
    ) -> Float[ArrayLike, ""]:
        off, slope = jax.value_and_grad(lambda uv: normal @ camera_b.intrinsics.lens.unproject(uv))(
            uv_px
        )
        return jnp.abs(off) / jnp.linalg.norm(slope)

    return jax.vmap(distance)(_planes(camera_b, camera_a, uv_a_px), uv_b_px)


@eqx.filter_jit
def _centre_shifts(
    camera: Camera, centres_mm: Float[ArrayLike, "n 2"], radius_mm: Float[ArrayLike, "n"]
) -> Float[ArrayLike, "n 2"]:
    def shift(
        centre_mm: Float[ArrayLike, "2"], radius: Float[ArrayLike, ""]
    ) -> Float[ArrayLike, "2"]:
        image_of_centre = project(camera, jnp.append(centre_mm, 0.0))
        return image_of_centre - image_of_circle_centre(camera, centre_mm, radius)

    return jax.vmap(shift)(centres_mm, radius_mm)
