import jax
import numpy as np
from hypothesis import given, strategies as st

from tests.geometry import conics
from tests.geometry.strategies import DISTORTED_LENS, LENS, cameras, real, vectors
from trinoc.geometry import camera as camera_module
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre

boundary_of_dual_conic = jax.jit(conics.boundary_of_dual_conic)
centre_of_dual_conic = jax.jit(conics.centre_of_dual_conic)
dual_conic_of_circle = jax.jit(conics.dual_conic_of_circle)
image_of_circle = jax.jit(conics.image_of_circle)
image_of_circle_centre = jax.jit(image_of_circle_centre)
project = jax.jit(camera_module.project)
shape_of_dual_conic = jax.jit(conics.shape_of_dual_conic)

ANGLES = np.linspace(0, 2 * np.pi, 60, endpoint=False)


def circle_points(centre, radius):
    ring = np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)
    return np.append(centre, 0.0) + radius * ring


@given(vectors(2, 50.0), real(1, 10))
def test_a_circle_is_its_own_conic(centre, radius):
    dual = dual_conic_of_circle(centre, radius)
    np.testing.assert_allclose(centre_of_dual_conic(dual), centre, atol=1e-9)
    np.testing.assert_allclose(shape_of_dual_conic(dual), radius**2 * np.eye(2), atol=1e-8)


@given(cameras(), vectors(2, 50.0), real(2, 10))
def test_the_image_of_a_circle_holds_the_images_of_its_points(camera, centre, radius):
    dual = image_of_circle(camera, centre, radius)
    conic = np.linalg.inv(np.asarray(dual) / dual[2, 2])
    points = jax.vmap(project, (None, 0))(camera, circle_points(centre, radius))
    scale = np.abs(conic).max() * (1 + (points**2).sum(1))
    rows = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    value = np.einsum("ni,ij,nj->n", rows, conic, rows)
    assert (abs(value) < 1e-8 * scale).all()


@given(cameras(), vectors(2, 50.0), real(2, 10))
def test_boundary_points_lie_on_the_ellipse(camera, centre, radius):
    dual = image_of_circle(camera, centre, radius)
    offset = np.asarray(boundary_of_dual_conic(dual, ANGLES)) - np.asarray(
        centre_of_dual_conic(dual)
    )
    shape = np.linalg.inv(shape_of_dual_conic(dual))
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", offset, shape, offset), 1.0, atol=1e-7)


def test_the_centre_of_the_image_is_not_the_image_of_the_centre():
    """The shift of the reference rig's circles is about 0.09 px, at most 0.12 px."""
    camera = Camera.from_degrees(
        LENS, pan_deg=23.568, tilt_deg=38.616, swing_deg=-0.994, distance_mm=472.894
    )
    grid = 20.0 * np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(-1, 2)
    ellipse = jax.vmap(image_of_circle_centre, (None, 0, None))(camera, grid, 6.0)
    centre = jax.vmap(project, (None, 0))(camera, np.pad(grid, ((0, 0), (0, 1))))
    shift = np.linalg.norm(ellipse - centre, axis=1)
    assert 0.07 < np.sqrt((shift**2).mean()) < 0.11
    assert shift.max() < 0.13


@given(st.sampled_from([LENS, DISTORTED_LENS]).flatmap(cameras), vectors(2, 40.0))
def test_a_vanishing_circle_is_imaged_at_its_centre(camera, centre):
    np.testing.assert_allclose(
        image_of_circle_centre(camera, centre, 1e-4),
        project(camera, np.append(centre, 0.0)),
        atol=1e-6,
    )


def test_with_distortion_the_centre_is_that_of_an_ellipse_fitted_to_the_curve():
    """The distorted curve is no ellipse: fits differ by up to 0.001 px."""
    import cv2

    camera = Camera.from_degrees(
        DISTORTED_LENS, pan_deg=20, tilt_deg=40, swing_deg=5, distance_mm=450
    )
    for centre in ([60.0, 60.0], [-60.0, 20.0], [0.0, -50.0]):
        curve = jax.vmap(project, (None, 0))(camera, circle_points(centre, 6.0))
        (u, v), _, _ = cv2.fitEllipse(np.asarray(curve, dtype=np.float32))
        np.testing.assert_allclose(
            image_of_circle_centre(camera, np.array(centre), 6.0), (u, v), atol=1e-3
        )
