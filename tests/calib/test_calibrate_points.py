"""Calibration of a camera from given points, on a plane and off it."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.stats import chi2

from tests.calib.simulated import LENS, TABLE_1, camera_of
from trinoc.calib import Status
from trinoc.calib.from_points import CalibrationResult, calibrate_points
from trinoc.calib.starts.resection import find_pose
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import PoseModel

CAMERA = camera_of(TABLE_1["left"])
NOISE_PX = 0.05


def block(random: np.random.Generator, count: int = 60) -> np.ndarray:
    return random.uniform([-60, -60, -40], [60, 60, 40], (count, 3))


def noisy_pixels(points: np.ndarray, random: np.random.Generator) -> np.ndarray:
    homogeneous = np.column_stack([points, np.ones(len(points))]) @ CAMERA.matrix_px.T
    exact = homogeneous[:, :2] / homogeneous[:, 2:]
    return exact + random.normal(0, NOISE_PX, exact.shape)


def errors(result: CalibrationResult) -> np.ndarray:
    """Errors of the parameters, in their order: turns about the camera's axes, centre, lens."""
    turn = np.asarray(result.camera.cam_from_world)[:, :3] @ CAMERA.cam_from_world[:, :3].T
    lens = result.camera.intrinsics
    values = np.concatenate([lens.focal_length_px, lens.principal_point_px])
    truth = np.concatenate([LENS.focal_length_px, LENS.principal_point_px])
    centre = np.asarray(result.camera.pose.centre_world_mm) - CAMERA.pose.centre_world_mm
    differences = [
        *np.degrees(cv2.Rodrigues(np.asarray(turn))[0].ravel()),
        *centre,
        *(values - truth),
    ]
    return np.array(differences[: len(result.parameters)])


@pytest.mark.parametrize("lens_given", [True, False])
def test_errors_are_those_that_the_covariance_claims(lens_given: bool) -> None:
    squared = []
    for seed in range(60):
        random = np.random.default_rng(seed)
        points = block(random)
        lens = LENS if lens_given else None
        result = calibrate_points(
            points,
            noisy_pixels(points, random),
            lens,
            image_size_px=(512, 480),
            systematics=Systematics(),
        )
        assert result.overall_status is Status.CONVERGED
        assert result.fits["camera"].sigma_factor == pytest.approx(NOISE_PX, rel=0.3)
        error = errors(result)
        squared.append(error @ np.linalg.solve(result.covariance, error) / len(error))
    # The mean of 60 chi-squares over their 6 or 10 degrees of freedom; the noise is estimated.
    assert np.mean(squared) == pytest.approx(1.0, abs=0.3)


@pytest.mark.parametrize("count", [0, 1, 2, 4])
def test_the_lens_is_the_one_that_the_points_ask_for(count: int) -> None:
    bent = np.where(np.arange(5) < count, [-0.12, 2.0, 0.004, -0.003, 0.0], 0.0)
    lens = Intrinsics(
        focal_length_px=LENS.focal_length_px, image_size_px=(512, 480), distortion=bent
    )
    camera, random = camera_of(TABLE_1["left"], lens), np.random.default_rng(3)
    points = block(random, 200)
    exact = np.stack([camera.project(point) for point in points])
    uv_px = exact + random.normal(0, 0.02, exact.shape)
    result = calibrate_points(points, uv_px, image_size_px=(512, 480))
    assert result.overall_status is Status.CONVERGED
    assert result.lens_parameters[4:] == ("k1", "k2", "p1", "p2")[:count]
    truth = np.concatenate([LENS.focal_length_px, LENS.principal_point_px, bent[:count]])
    values = np.asarray(promote_lens(result.camera.intrinsics.lens).parameters)[: 4 + count]
    lens_covariance = result.covariance[6:, 6:]
    assert (values - truth) @ np.linalg.solve(lens_covariance, values - truth) < chi2.ppf(
        0.9999, len(truth)
    )


def test_exact_points_ask_for_nothing() -> None:
    points = block(np.random.default_rng(2), 30)
    exact = np.stack([CAMERA.project(point) for point in points])
    assert calibrate_points(points, exact, LENS).overall_status is Status.CONVERGED


def test_an_uncertain_lens_is_in_the_covariance() -> None:
    random = np.random.default_rng(4)
    points = block(random)
    uv_px = noisy_pixels(points, random)
    exact, usual = (
        calibrate_points(points, uv_px, LENS, systematics=systematics)
        for systematics in (Systematics(), None)
    )
    focal = np.array([0.01, 0.01]) * LENS.focal_length_px
    moved = calibrate_points(
        points,
        uv_px,
        Intrinsics(
            image_size_px=LENS.image_size_px,
            focal_length_px=LENS.focal_length_px + focal,
            principal_point_px=LENS.principal_point_px,
        ),
        systematics=Systematics(lens_covariance=np.diag(focal**2)),
    )
    added = usual.covariance - exact.covariance
    assert np.linalg.eigvalsh(added).min() > -1e-9 * np.trace(added)
    # A focal length that is one sigma larger puts the camera away from the points.
    shift = np.asarray(moved.camera.pose.centre_world_mm) - exact.camera.pose.centre_world_mm
    axis = np.asarray(exact.camera.cam_from_world)[2, :3]
    sigma = np.sqrt(axis @ usual.covariance[3:6, 3:6] @ axis)
    assert abs(axis @ shift) == pytest.approx(sigma, rel=0.25)


def test_points_of_a_plane_do_where_the_lens_is_known() -> None:
    random = np.random.default_rng(1)
    points = block(random) * [1, 1, 0]
    result = calibrate_points(points, noisy_pixels(points, random), LENS)
    assert (np.abs(errors(result)) < 5 * np.sqrt(np.diag(result.covariance))).all()
    with pytest.raises(InputError, match="one plane"):
        calibrate_points(points, noisy_pixels(points, random), image_size_px=(512, 480))
    with pytest.raises(CalibrationError, match="do not determine"):
        calibrate_points(
            points, noisy_pixels(points, random), LENS, free=("fx_px", "fy_px", "cx_px", "cy_px")
        )


def test_a_point_that_is_another_is_left_out_and_told() -> None:
    random = np.random.default_rng(2)
    points = block(random)
    uv_px = noisy_pixels(points, random)
    uv_px[[3, 17]] += [4.0, -3.0]
    result = calibrate_points(points, uv_px, LENS)
    np.testing.assert_array_equal(np.flatnonzero(~result.fits["camera"].used), [3, 17])
    assert (np.abs(errors(result)) < 5 * np.sqrt(np.diag(result.covariance))).all()


def test_what_cannot_be_is_refused_in_words() -> None:
    random = np.random.default_rng(3)
    points = block(random)
    uv_px = noisy_pixels(points, random)
    with pytest.raises(CalibrationError, match="left-handed"):
        calibrate_points(points * [-1, 1, 1], uv_px, image_size_px=(512, 480))
    with pytest.raises(InputError, match="size of the image is missing"):
        calibrate_points(points, uv_px)
    with pytest.raises(InputError, match="too few"):
        calibrate_points(points[:3], uv_px[:3], LENS)
    with pytest.raises(InputError, match="has the parameters"):
        calibrate_points(points, uv_px, LENS, free=("zoom",))
    with pytest.raises(InputError, match="not finite"):
        calibrate_points(points, uv_px * np.nan, LENS)


@pytest.mark.skipif("TRINOC_DATA" not in os.environ, reason="TRINOC_DATA names no folder of data")
@pytest.mark.parametrize("name", ["camera1", "camera2", "camera3"])
def test_a_real_rig_stands_where_opencv_puts_it(name: str) -> None:
    folder = Path(os.environ["TRINOC_DATA"]) / "myptv_rig"
    if not folder.is_dir():
        pytest.skip("TRINOC_DATA holds no myptv_rig")
    with np.load(folder / "correspondences.npz") as table:
        uv_px, points = table[name][:, :2], table[name][:, 2:]
    free = calibrate_points(points, uv_px, image_size_px=(1280, 1024))
    assert free.fits["camera"].used.mean() > 0.97
    # A direct linear transform, with skew and no distortion, has residuals of .23, .50, .54 px.
    assert free.rms_px() < 0.5
    assert free.overall_status is Status.CONVERGED
    posed = calibrate_points(points, uv_px, free.camera.intrinsics)
    used = posed.fits["camera"].used
    matrix = np.array(posed.camera.intrinsics.matrix)
    # OpenCV has no skew: what it moves along u is taken off.
    along_u = matrix[0, 1] * (uv_px[:, 1] - matrix[1, 2]) / matrix[1, 1]
    straight_px, matrix[0, 1] = uv_px - along_u[:, None] * [1, 0], 0.0
    bent = np.asarray(posed.camera.intrinsics.distortion)
    _, turn, shift = cv2.solvePnP(points[used].copy(), straight_px[used].copy(), matrix, bent)
    rotation = cv2.Rodrigues(turn)[0]
    np.testing.assert_allclose(
        -rotation.T @ shift.ravel(), posed.camera.pose.centre_world_mm, atol=0.01
    )


@pytest.mark.parametrize("model", [PoseModel.AIMED, PoseModel.AIM_FREE])
def test_the_parameters_over_a_sheet_scatter_as_their_covariance_says(model: PoseModel) -> None:
    truth = np.array([*TABLE_1["left"], 0.0, 0.0])[: model.size]
    squared = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        points = block(random)
        result = calibrate_points(
            points,
            noisy_pixels(points, random),
            LENS,
            pose_model=model.option_name,
            systematics=Systematics(),
        )
        assert result.parameters == tuple(f"camera.{name}" for name in model.parameter_names)
        camera = result.camera
        values = [camera.pan_deg, camera.tilt_deg, camera.swing_deg, camera.distance_mm]
        error = np.array([*values, *camera.aim_mm])[: model.size] - truth
        squared.append(error @ np.linalg.solve(result.covariance, error) / model.size)
    # The mean of 40 chi-squares over their 4 or 6 degrees of freedom; the noise is estimated.
    assert np.mean(squared) == pytest.approx(1.0, abs=0.4)


def test_a_free_aim_is_any_rigid_motion() -> None:
    random = np.random.default_rng(4)
    points = block(random)
    uv_px = noisy_pixels(points, random)
    rigid, aimed = (
        calibrate_points(points, uv_px, LENS, pose_model=m) for m in ("rigid", "aim-free")
    )
    np.testing.assert_allclose(
        aimed.camera.cam_from_world, rigid.camera.cam_from_world, rtol=1e-6, atol=1e-6
    )


@pytest.mark.parametrize("count", [8, 60])
@pytest.mark.parametrize("free", [None, ("fx_px", "fy_px")])
def test_a_left_handed_frame_is_refused_with_and_without_a_lens(count, free) -> None:
    random = np.random.default_rng(count)
    points = block(random, count)
    uv_px = noisy_pixels(points, random)
    upward = np.column_stack([uv_px[:, 0], 479 - uv_px[:, 1]])
    if count == 60:
        assert calibrate_points(points, uv_px, LENS, free=free).overall_status is Status.CONVERGED
    for points_mm, pixels in (
        (points * [-1, 1, 1], uv_px),
        (points * [1, -1, 1], uv_px),
        (points * [1, 1, -1], uv_px),
        (-points, uv_px),
        (points, upward),
    ):
        sentences = set()
        for lens in (LENS, None):
            with pytest.raises(CalibrationError, match="left-handed, or v is counted") as caught:
                calibrate_points(
                    points_mm,
                    pixels,
                    lens,
                    image_size_px=(512, 480),
                    free=free if lens else None,
                )
            sentences.add(str(caught.value))
        assert len(sentences) == 1


def test_a_left_handed_frame_is_refused_among_outliers() -> None:
    random = np.random.default_rng(4)
    points = block(random)
    uv_px = noisy_pixels(points, random)
    uv_px[:3] += [30.0, -50.0]
    assert calibrate_points(points, uv_px, LENS).overall_status is Status.CONVERGED
    with pytest.raises(CalibrationError, match="left-handed"):
        calibrate_points(points * [1, 1, -1], uv_px, LENS)


def test_a_plane_has_no_handedness() -> None:
    random = np.random.default_rng(5)
    points = block(random) * [1, 1, 0]
    uv_px = noisy_pixels(points, random)
    right = calibrate_points(points, uv_px, LENS)
    mirrored = calibrate_points(points * [1, 1, -1], uv_px, LENS)
    one, other = (result.fits["camera"].residuals_px for result in (mirrored, right))
    assert one.shape == uv_px.shape
    np.testing.assert_allclose(one, other, atol=1e-6)


@pytest.mark.parametrize("distance", [1.0, 6.0])
@pytest.mark.parametrize("count", [4, 5, 6, 12])
def test_a_right_handed_frame_is_never_called_left_handed(count, distance) -> None:
    """The points are few, and may be so far away that both frames fit nearly alike."""
    lens = Intrinsics(
        focal_length_px=(1000 * distance,) * 2,
        principal_point_px=(255.5, 239.5),
        image_size_px=(512, 480),
    )
    for seed in range(40):
        random = np.random.default_rng(seed)
        points = block(random, count)
        turn = cv2.Rodrigues(random.normal(0, 1, 3))[0]
        in_camera_mm = points @ turn.T + [0, 0, 500 * distance]
        uv_px = 1000 * distance * in_camera_mm[:, :2] / in_camera_mm[:, 2:] + [255.5, 239.5]
        find_pose(points, uv_px + random.normal(0, 0.3, uv_px.shape), lens)
