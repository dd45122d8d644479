import jax
import numpy as np
import pytest
from hypothesis import given, strategies as st

from tests.geometry import conics
from tests.geometry.strategies import (
    DISTORTED_LENS,
    LENS,
    cameras,
    points_near_sheet,
    real,
    vectors,
)
from trinoc.errors import InputError
from trinoc.geometry import Pose, camera as camera_module
from trinoc.geometry.camera import Camera, projection_matrix
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.pose import PoseModel

depth_mm = jax.jit(camera_module.depth_mm)
pixel_from_sheet_homography = jax.jit(conics.pixel_from_sheet_homography)
project = jax.jit(camera_module.project)
sheet_from_pixel = jax.jit(camera_module.sheet_from_pixel)
undistort_pixel = jax.jit(Intrinsics.undistort_pixel)
viewing_direction = jax.jit(camera_module.viewing_direction)


def homogeneous(point):
    return np.append(np.asarray(point), 1.0)


@given(cameras())
def test_the_parameters_survive_the_pose(camera):
    rebuilt = Camera.from_degrees(
        camera.intrinsics,
        pan_deg=camera.pan_deg,
        tilt_deg=camera.tilt_deg,
        swing_deg=camera.swing_deg,
        distance_mm=camera.distance_mm,
        aim_mm=camera.aim_mm,
    )
    np.testing.assert_allclose(rebuilt.cam_from_world, camera.cam_from_world, atol=1e-9)


@given(cameras())
def test_the_aim_is_imaged_at_the_principal_point(camera):
    uv = project(camera, np.append(camera.aim_mm, 0.0))
    np.testing.assert_allclose(uv, camera.intrinsics.principal_point_px, atol=1e-9)


@given(cameras(), points_near_sheet())
def test_projection_agrees_with_the_matrix(camera, point):
    u, v, w = camera.matrix_px @ homogeneous(point)
    assert depth_mm(camera, point) > 0
    np.testing.assert_allclose(project(camera, point), (u / w, v / w), atol=1e-9)
    np.testing.assert_allclose(projection_matrix(camera), camera.matrix_px, atol=1e-12)


@given(st.sampled_from([LENS, DISTORTED_LENS]).flatmap(cameras), points_near_sheet())
def test_the_viewing_ray_passes_through_the_point(camera, point):
    direction = viewing_direction(camera, project(camera, point))
    offset = point - camera.centre_world_mm
    np.testing.assert_allclose(np.cross(direction, offset / np.linalg.norm(offset)), 0, atol=1e-9)
    assert direction @ offset > 0


@given(st.sampled_from([LENS, DISTORTED_LENS]).flatmap(cameras), vectors(2, 60.0))
def test_sheet_and_pixel_are_inverse(camera, sheet_mm):
    uv = project(camera, np.append(sheet_mm, 0.0))
    np.testing.assert_allclose(sheet_from_pixel(camera, uv), sheet_mm, atol=1e-6)
    u, v, w = pixel_from_sheet_homography(camera) @ homogeneous(sheet_mm)
    np.testing.assert_allclose(undistort_pixel(camera.intrinsics, uv), (u / w, v / w), atol=1e-7)


@given(cameras(), real(-5, 5).filter(lambda scale: abs(scale) > 1e-3))
def test_a_camera_survives_its_matrix_at_any_scale_and_sign(camera, scale):
    rebuilt = Camera.from_matrix(scale * camera.matrix_px, (512, 480))
    np.testing.assert_allclose(rebuilt.matrix_px, camera.matrix_px, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(rebuilt.cam_from_world, camera.cam_from_world, atol=1e-7)


@pytest.mark.parametrize(
    "matrix", [np.zeros((3, 4)), np.full((3, 4), np.nan), np.eye(3), np.eye(3, 4)[[0, 1, 1]]]
)
def test_what_is_no_camera_is_refused(matrix):
    with pytest.raises(InputError, match="projection matrix"):
        Camera.from_matrix(matrix, (512, 480))


def test_a_camera_that_looks_away_from_the_sheet_has_no_distance():
    up = Camera(LENS, Pose(np.concatenate([np.eye(3), [[0.0], [0.0], [-10.0]]], axis=1)))
    assert np.isnan(up.distance_mm)
    assert np.isnan(up.aim_mm).all()


@jax.jit
def there_and_back(lens, ray):
    return lens.undistort(lens.distort(ray))


@given(vectors(2, 0.3))
def test_undistort_inverts_distort(ideal):
    round_trip = there_and_back(DISTORTED_LENS.lens, np.append(ideal, 1.0))
    np.testing.assert_allclose(round_trip[:2], ideal, atol=1e-12)


def test_distortion_keeps_the_principal_point_and_is_the_identity_without_coefficients():
    lens = DISTORTED_LENS.lens
    np.testing.assert_array_equal(lens.distort(np.array([0.0, 0.0, 1.0])), np.zeros(2))
    ideal = BrownConrady.from_parameters(np.append(lens.parameters[:4], np.zeros(5)))
    np.testing.assert_array_equal(ideal.distort(np.array([0.1, -0.2, 1.0])), [0.1, -0.2])


def test_distortion_agrees_with_opencv():
    import cv2

    points = np.random.default_rng(0).uniform(-0.25, 0.25, (20, 2))
    expected, _ = cv2.projectPoints(
        np.concatenate([points, np.ones((20, 1))], axis=1), np.zeros(3), np.zeros(3),
        np.asarray(DISTORTED_LENS.matrix), np.asarray(DISTORTED_LENS.distortion),
    )  # fmt: skip
    ours = jax.vmap(DISTORTED_LENS.pixel_from_normalised)(points)
    np.testing.assert_allclose(ours, expected.reshape(-1, 2), atol=1e-9)


def test_intrinsics_in_pixels_and_in_millimetres_agree():
    pixels = Intrinsics(focal_length_px=(16 / 0.0162, 16 / 0.0134), image_size_px=(512, 480))
    np.testing.assert_allclose(pixels.matrix, LENS.matrix)
    np.testing.assert_allclose(LENS.principal_point_px, (255.5, 239.5))
    assert LENS.focal_length_mm == pytest.approx(16)
    assert pixels.focal_length_mm is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"focal_length_mm": 16}, "focal length is not determined"),
        ({"focal_length_mm": 16, "focal_length_px": 900, "pixel_pitch_mm": 0.01}, "not determined"),
        ({"focal_length_mm": -1, "pixel_pitch_mm": 0.01}, "focal_length_mm is -1"),
        ({"focal_length_mm": 16, "pixel_pitch_mm": (0.01, 0)}, "pixel_pitch_mm"),
        ({"focal_length_px": 900, "image_size_px": (0, 480)}, "image_size_px"),
        ({"focal_length_px": 900, "distortion": range(8)}, "at most 5"),
    ],
)
def test_impossible_intrinsics_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Intrinsics(**({"image_size_px": (512, 480)} | arguments))


@given(cameras(), vectors(6, 0.01))
def test_a_motion_moves_the_centre_and_turns_the_axes(camera, motion):
    moved = camera.pose.retract(motion, PoseModel.RIGID, 1.0)
    np.testing.assert_allclose(
        moved.centre_world_mm, camera.pose.centre_world_mm + motion[3:], atol=1e-9
    )
    np.testing.assert_allclose(
        camera.pose.retract(np.zeros(6), PoseModel.RIGID, 1.0).cam_from_world,
        camera.cam_from_world,
        atol=1e-9,
    )


def pixel_of_point(parameters):
    camera = Camera(LENS, Pose.from_parameters(parameters))
    return camera_module.project(camera, np.array([20.0, -30.0, 10.0]))


pixel_of_point_jitted = jax.jit(pixel_of_point)
forward_jacobian = jax.jit(jax.jacfwd(pixel_of_point))
reverse_jacobian = jax.jit(jax.jacrev(pixel_of_point))


@given(cameras())
def test_derivatives_of_projection_agree_with_differences(camera):
    start = camera.pose.parameters
    forward = forward_jacobian(start)
    np.testing.assert_allclose(forward, reverse_jacobian(start), rtol=1e-9, atol=1e-9)
    for i, step in enumerate([1e-6] * 3 + [1e-3] * 3):
        delta = step * np.eye(6)[i]
        above, below = pixel_of_point_jitted(start + delta), pixel_of_point_jitted(start - delta)
        np.testing.assert_allclose(
            forward[:, i], (above - below) / (2 * step), rtol=1e-5, atol=1e-5
        )
