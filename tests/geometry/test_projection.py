"""Projection by a matrix in all its forms, and its derivatives against differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.strategies import LENS
from trinoc.geometry import line_through, project
from trinoc.geometry.camera import Camera
from trinoc.geometry.lines import signed_distance
from trinoc.geometry.projection import (
    distances_from_line,
    homogeneous_pixel,
    image_of_point,
    pixel_change,
    project_by_matrix,
    project_with_jacobian,
)
from trinoc.numerics.vectors import vector3

CAMERAS = [
    Camera.from_degrees(LENS, pan_deg=pan, tilt_deg=40.0, swing_deg=5.0, distance_mm=450.0)
    for pan in (-50.0, 3.0, 45.0)
]
MATRICES = np.stack([np.asarray(camera.matrix_px) for camera in CAMERAS])
POINTS = np.random.default_rng(0).uniform(-50.0, 50.0, (7, 3))
STEP = 1e-4


def difference(value, point):
    """Central differences of a function by the last axis of its argument, exact to 1e-9."""
    by = [
        value(point + STEP * axis) - value(point - STEP * axis) for axis in np.eye(point.shape[-1])
    ]
    return np.stack(by, axis=-1) / (2 * STEP)


def test_a_matrix_projects_as_its_camera_does():
    expected = [[project(camera, point) for point in POINTS] for camera in CAMERAS]
    np.testing.assert_allclose(project_by_matrix(MATRICES, POINTS[None]), expected, atol=1e-9)
    for camera, matrix, expected_px in zip(CAMERAS, MATRICES, expected, strict=True):
        np.testing.assert_allclose(project_by_matrix(matrix, POINTS), expected_px, atol=1e-9)
        projected = project_with_jacobian(matrix, POINTS)
        np.testing.assert_allclose(projected.uv_px, expected_px, atol=1e-9)
        turned = POINTS @ camera.pose.rotation.T + camera.pose.translation_mm
        np.testing.assert_allclose(projected.depth, turned[:, 2])


def test_pixels_move_with_points_as_differences_say():
    for matrices, points in ((MATRICES[0], POINTS), (MATRICES, POINTS[None])):
        by_point = project_with_jacobian(matrices, points).by_point
        expected = difference(
            lambda moved_points, m=matrices: project_by_matrix(m, moved_points), points
        )
        np.testing.assert_allclose(by_point, expected, atol=1e-8)


def test_a_traced_projection_is_that_of_numpy_and_differentiates_to_its_jacobian():
    ends = POINTS[:2]
    plain = project_with_jacobian(MATRICES, ends[None])
    traced = jax.jit(project_with_jacobian)(MATRICES, ends[None])
    for one, other in zip(traced, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)
    slope = jax.jit(jax.jacfwd(project_by_matrix, argnums=1))(MATRICES[0], ends[0])
    np.testing.assert_allclose(slope, plain.by_point[0, 0], rtol=1e-12)


def test_coordinates_apart_give_the_same_pixels_and_changes():
    matrix, direction = MATRICES[1], np.array([0.3, -0.2, 0.9])
    uv, depth = image_of_point(matrix, vector3(POINTS))
    projected = project_with_jacobian(matrix, POINTS)
    np.testing.assert_allclose(np.stack(uv, axis=-1), projected.uv_px, rtol=1e-12)
    np.testing.assert_allclose(depth, projected.depth, rtol=1e-12)
    change = pixel_change(uv, depth, vector3(matrix[:, :3] @ direction))
    np.testing.assert_allclose(np.stack(change, axis=-1), projected.by_point @ direction, rtol=1e-9)


def test_homogeneous_pixels_hold_the_depth():
    image = homogeneous_pixel(MATRICES, POINTS[None])
    np.testing.assert_allclose(image[..., 2], project_with_jacobian(MATRICES, POINTS[None]).depth)


@pytest.mark.parametrize("points", [POINTS[:2], POINTS[2:4]])
def test_distances_from_a_line_and_their_derivatives(points):
    ends = np.array([[-30.0, 5.0, 8.0], [25.0, -12.0, 20.0]])
    pixels = project_by_matrix(MATRICES, points[None])
    from_line = distances_from_line(MATRICES, ends, pixels)
    for matrix, camera_pixels, distances in zip(
        MATRICES, pixels, from_line.distance_px, strict=True
    ):
        line = line_through(*jnp.asarray(project_by_matrix(matrix, ends)))
        expected = [signed_distance(line, jnp.asarray(pixel)) for pixel in camera_pixels]
        np.testing.assert_allclose(distances, expected, atol=1e-9)

    def distance(flat):
        return distances_from_line(MATRICES, flat.reshape(2, 3), pixels).distance_px

    expected = difference(distance, ends.reshape(6)).reshape(3, 2, 2, 3)
    np.testing.assert_allclose(from_line.by_ends, expected, atol=1e-7)
    # The same for one camera at a time, and traced.
    alone = jax.jit(jax.vmap(distances_from_line, (0, None, 0)))(MATRICES, ends, pixels)
    np.testing.assert_allclose(alone.by_ends, from_line.by_ends, rtol=1e-9)
