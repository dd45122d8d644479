"""What the page asks of cameras, each question compiled once for all cameras of a rig."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry import (
    Camera,
    epipolar_line,
    fundamental_matrix,
    image_of_circle_centre,
    project,
    projection_matrix,
)
from trinoc.numerics import ArrayLike, in_float64

# Numbers of points are rounded up to powers of two, so that other counts compile nothing new.
FEWEST_POINTS = 64


@in_float64
def calibration_matrix(camera: Camera) -> Float[np.ndarray, "3 3"]:
    """K of a camera."""
    return np.asarray(_calibration_matrix(camera))


@in_float64
def fundamental_from(camera_a: Camera, camera_b: Camera) -> Float[np.ndarray, "3 3"]:
    """F_ba of undistorted pixels, from view a to view b, scaled to unit norm."""
    matrix = np.asarray(_fundamental(camera_b, camera_a))
    return matrix / np.linalg.norm(matrix)


@in_float64
def epipolar_lines(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """Lines of view b, in undistorted pixels, that belong to points of view a."""
    return np.asarray(_epipolar_lines(camera_b, camera_a, _padded(uv_a_px)))[: len(uv_a_px)]


@in_float64
def undistorted_pixels(camera: Camera, uv_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Where the points would lie if the lens had no distortion."""
    return np.asarray(_undistorted(camera, _padded(uv_px)))[: len(uv_px)]


@in_float64
def distorted_pixels(camera: Camera, uv_px: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Inverse of `undistorted_pixels`."""
    return np.asarray(_distorted(camera, _padded(uv_px)))[: len(uv_px)]


@in_float64
def shift_of_circle_centres(
    camera: Camera, centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 2"]:
    """From the centre of each circle's image to the image of the circle's centre, in pixels."""
    return np.asarray(_centre_shifts(camera, centres_mm, radius_mm))


def _padded(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "m 2"]:
    size = max(FEWEST_POINTS, 1 << (len(points) - 1).bit_length())
    return np.concatenate([points, np.repeat(points[-1:], size - len(points), axis=0)])


@eqx.filter_jit
def _calibration_matrix(camera: Camera) -> Float[ArrayLike, "3 3"]:
    return camera.intrinsics.matrix


@eqx.filter_jit
def _fundamental(camera_b: Camera, camera_a: Camera) -> Float[ArrayLike, "3 3"]:
    return fundamental_matrix(projection_matrix(camera_b), projection_matrix(camera_a))


@eqx.filter_jit
def _epipolar_lines(
    camera_b: Camera, camera_a: Camera, uv_a_px: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 3"]:
    fundamental = fundamental_matrix(projection_matrix(camera_b), projection_matrix(camera_a))
    undistorted = jax.vmap(camera_a.intrinsics.undistort_pixel)(uv_a_px)
    return jax.vmap(epipolar_line, in_axes=(None, 0))(fundamental, undistorted)


@eqx.filter_jit
def _undistorted(camera: Camera, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(camera.intrinsics.undistort_pixel)(uv_px)


@eqx.filter_jit
def _distorted(camera: Camera, uv_px: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(camera.intrinsics.distort_pixel)(uv_px)


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
