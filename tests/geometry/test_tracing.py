"""Constructors and properties of cameras can be traced; otherwise they return NumPy float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.geometry.strategies import DISTORTED_LENS, LENS
from trinoc.geometry import Pose, project
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.projection import project_by_matrix, project_point

# Pan, tilt, swing in degrees, distance, aim X and Y in mm, focal length in mm, k1.
START = np.array([23.568, 38.616, -0.994, 472.894, 2.0, -3.0, 16.0, -0.1])
POINT_MM = np.array([20.0, -30.0, 10.0])


def camera_of(numbers):
    lens = Intrinsics(
        focal_length_mm=numbers[6],
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=[numbers[7]],
    )
    return Camera.from_degrees(
        lens,
        pan_deg=numbers[0],
        tilt_deg=numbers[1],
        swing_deg=numbers[2],
        distance_mm=numbers[3],
        aim_mm=numbers[4:6],
    )


PROPERTIES = {
    "pan_deg": lambda camera: camera.pan_deg,
    "tilt_deg": lambda camera: camera.tilt_deg,
    "swing_deg": lambda camera: camera.swing_deg,
    "distance_mm": lambda camera: camera.distance_mm,
    "aim_mm": lambda camera: jnp.stack([jnp.asarray(value) for value in camera.aim_mm]),
    "centre_world_mm": lambda camera: camera.centre_world_mm,
    "matrix_px": lambda camera: camera.matrix_px,
    "intrinsics.matrix": lambda camera: camera.intrinsics.matrix,
    "focal_length_mm": lambda camera: camera.intrinsics.focal_length_mm,
    "principal_point_px": lambda camera: camera.intrinsics.principal_point_px,
    "distortion": lambda camera: camera.intrinsics.distortion,
    "project": lambda camera: camera.project(POINT_MM),
    "from_matrix": lambda camera: (
        Intrinsics.from_matrix(camera.intrinsics.matrix, (512, 480)).focal_length_px
    ),
}


@pytest.mark.parametrize("name", PROPERTIES)
def test_every_property_traces_and_agrees_with_numpy(name):
    def value(numbers):
        return jnp.asarray(PROPERTIES[name](camera_of(numbers)))

    @jax.jit
    def traced(numbers, more):
        slopes = jax.jacfwd(value)(numbers), jax.jacrev(value)(numbers)
        return value(numbers), jax.vmap(value)(more), slopes

    plain = value(START)
    one, both, (forward, reverse) = traced(START, np.stack([START, START + 0.1]))
    np.testing.assert_allclose(one, plain, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(both[0], plain, rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(both[1], value(START + 0.1), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8, atol=1e-8)
    for k in range(len(START)):
        step = 1e-5 * np.eye(len(START))[k]
        numeric = (value(START + step) - value(START - step)) / 2e-5
        np.testing.assert_allclose(forward[..., k], numeric, rtol=1e-5, atol=1e-5)


def test_outside_a_trace_everything_is_numpy_in_double_precision():
    with jax.enable_x64(False):
        camera = camera_of(START)
        for name in ("centre_world_mm", "matrix_px", "cam_from_world"):
            value = getattr(camera, name)
            assert isinstance(value, np.ndarray)
            assert value.dtype == np.float64
        assert isinstance(camera.pan_deg, float)
        assert camera.project(POINT_MM).dtype == np.float64
        np.testing.assert_allclose([camera.pan_deg, *camera.aim_mm], START[[0, 4, 5]], atol=1e-10)


def test_constants_inside_a_trace_stay_numpy():
    @jax.jit
    def scaled(factor):
        return factor * camera_of(START).matrix_px

    np.testing.assert_allclose(scaled(2.0), 2.0 * camera_of(START).matrix_px, rtol=1e-12)


@pytest.mark.parametrize("lens", [LENS, DISTORTED_LENS])
def test_all_projections_are_one(lens):
    numbers = dict(zip(("pan_deg", "tilt_deg", "swing_deg", "distance_mm"), START, strict=False))
    camera = Camera.from_degrees(lens, **numbers)
    expected = camera.project(POINT_MM)
    np.testing.assert_allclose(project(camera, POINT_MM), expected, rtol=1e-12)
    by_parts = project_point(camera.pose, camera.intrinsics.lens, POINT_MM)
    np.testing.assert_allclose(by_parts, expected, rtol=1e-12)
    ideal = project_by_matrix(camera.matrix_px, POINT_MM[None])[0]
    assert isinstance(ideal, np.ndarray)
    np.testing.assert_allclose(lens.distort_pixel(ideal), expected, rtol=1e-12)


def test_a_stack_of_cameras_projects_under_vmap():
    cameras = jax.vmap(camera_of)(np.stack([START, START + 0.1]))
    assert cameras.pose.cam_from_world.shape == (2, 3, 4)
    both = jax.vmap(project, in_axes=(0, None))(cameras, POINT_MM)
    np.testing.assert_allclose(both[1], camera_of(START + 0.1).project(POINT_MM), rtol=1e-10)


def test_a_pose_is_that_of_its_parameters():
    parameters = np.array([*np.radians(START[:3]), *START[3:6]])
    np.testing.assert_allclose(Pose.from_parameters(parameters).parameters, parameters, rtol=1e-10)
