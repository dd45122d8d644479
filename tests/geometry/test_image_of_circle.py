"""The centre of a circle's image agrees with the closed form of conics and with an integral."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given

from tests.geometry import conics
from tests.geometry.strategies import DISTORTED_LENS, cameras, real, vectors
from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import circle_centre_offset, image_of_circle_centre


def sheet_to_picture(camera):
    return lambda point_mm: project(camera, jnp.append(point_mm, 0.0))


centre_of_image = jax.jit(image_of_circle_centre)


@jax.jit
def closed_form(camera, centre, radius):
    return conics.centre_of_dual_conic(conics.image_of_circle(camera, centre, radius))


@jax.jit
def images_and_areas(camera, points_mm):
    mapping = sheet_to_picture(camera)
    return jax.vmap(mapping)(points_mm), jax.vmap(jax.jacfwd(mapping))(points_mm)


@given(cameras(), vectors(2, 50.0), real(1, 15))
def test_under_a_homography_it_is_the_centre_of_the_conic(camera, centre, radius):
    np.testing.assert_allclose(
        centre_of_image(camera, centre, radius), closed_form(camera, centre, radius), atol=1e-8
    )


@given(cameras(DISTORTED_LENS), vectors(2, 40.0), real(2, 10))
def test_with_distortion_it_is_the_centroid_of_the_images_of_the_disc(camera, centre, radius):
    """Gauss's rule over the disc. Each point is weighted with the area of its image."""
    node, weight = np.polynomial.legendre.leggauss(8)
    share, angle = 0.5 * (node + 1), np.arange(24) * (2 * np.pi / 24)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points_mm = (centre + radius * share[:, None, None] * ring).reshape(-1, 2)
    image, slope = images_and_areas(camera, points_mm)
    area = np.repeat(weight * share, len(angle)) * np.abs(np.linalg.det(slope))
    np.testing.assert_allclose(
        centre_of_image(camera, centre, radius), area @ image / area.sum(), atol=1e-8
    )


def test_a_point_has_no_offset_and_finite_derivatives():
    camera = Camera.from_degrees(
        DISTORTED_LENS, pan_deg=20, tilt_deg=40, swing_deg=5, distance_mm=450
    )
    mapping = sheet_to_picture(camera)
    centre = np.array([10.0, 20.0])

    def offset(centre_mm):
        return circle_centre_offset(mapping, centre_mm, 0.0)

    np.testing.assert_array_equal(jax.jit(offset)(centre), 0.0)
    np.testing.assert_array_equal(jax.jit(jax.jacfwd(offset))(centre), 0.0)
