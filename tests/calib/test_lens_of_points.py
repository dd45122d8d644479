"""Points determine the lens model that they need, or refute the one that was fixed."""

import re

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from tests.calib.simulated import DISTORTED_LENS, LENS, TABLE_1, camera_of
from trinoc.calib import Status
from trinoc.calib.from_points import CalibrationResult, calibrate_points
from trinoc.calib.lens_of_points import (
    fit_without_outliers,
    lens_parameter_names,
    problem_of_points,
    score_of_points,
)
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.pose import PoseModel

NOISE_PX = 0.05
SIZE_PX = LENS.image_size_px
# As of a sensor that is tilted against its lens.
SKEWED = Intrinsics(
    focal_length_px=LENS.focal_length_px,
    image_size_px=SIZE_PX,
    skew_px=3e-3 * float(LENS.focal_length_px[0]),
)


def block(random: np.random.Generator, count: int = 150) -> np.ndarray:
    return random.uniform([-60, -60, -40], [60, 60, 40], (count, 3))


def see(camera: Camera, points: np.ndarray, random: np.random.Generator) -> np.ndarray:
    exact = np.stack([camera.project(point) for point in points])
    return exact + random.normal(0, NOISE_PX, exact.shape)


def squared_error_of_centre(result: CalibrationResult, camera: Camera) -> float:
    """Squared error of the centre by its reported covariance: a chi-square of three freedoms."""
    error = np.asarray(result.camera.pose.centre_world_mm) - camera.pose.centre_world_mm
    return float(error @ np.linalg.solve(result.covariance[3:6, 3:6], error))


@pytest.mark.parametrize("group", [("skew_px",), ("fx_px", "fy_px"), ("k1", "k2", "p1", "p2")])
def test_noise_alone_asks_for_no_other_lens_by_its_chance_and_no_oftener(
    group: tuple[str, ...],
) -> None:
    """The p-value is uniform if the fixed parameters are right, even with 12 points."""
    camera, chances = camera_of(TABLE_1["left"]), []
    for seed in range(120):
        random = np.random.default_rng([7, seed])
        points = block(random, 12)
        uv_px = see(camera, points, random)
        problem = problem_of_points(camera, points, uv_px, (), PoseModel.RIGID)
        score = score_of_points(fit_without_outliers(problem))
        columns = [lens_parameter_names(problem).index(name) for name in group]
        chances.append(score.p_value(score.test(columns)))
    assert kstest(chances, "uniform").pvalue > 1e-3


def test_a_skew_that_points_ask_for_is_fitted_and_its_covariance_is_true() -> None:
    """A skew fixed at 0 would put the centres 4 to 13 reported sigmas off without a warning."""
    camera, squared = camera_of(TABLE_1["left"], SKEWED), []
    for seed in range(40):
        random = np.random.default_rng([8, seed])
        points = block(random)
        result = calibrate_points(points, see(camera, points, random), image_size_px=SIZE_PX)
        assert result.overall_status is Status.CONVERGED
        assert result.lens_parameters == (*AFFINE_PARAMETERS, "skew_px")
        assert "sensors have no skew" in result.notes[0]
        off = float(result.camera.intrinsics.skew_px) - float(SKEWED.skew_px)
        assert abs(off) < 4.5 * result.sigma("skew_px")
        squared.append(squared_error_of_centre(result, camera))
    # Shares of 40 by the binomial law, three standard deviations wide.
    assert np.mean(np.array(squared) < chi2.ppf(0.5, 3)) == pytest.approx(0.5, abs=0.24)
    assert np.mean(np.array(squared) < chi2.ppf(0.95, 3)) >= 0.85


def test_skew_and_distortion_are_found_together() -> None:
    lens = Intrinsics(
        focal_length_px=LENS.focal_length_px,
        image_size_px=SIZE_PX,
        skew_px=SKEWED.skew_px,
        distortion=(-0.2, 0.0, 0.0, 0.0, 0.0),
    )
    camera, random = camera_of(TABLE_1["left"], lens), np.random.default_rng(3)
    points = block(random, 250)
    result = calibrate_points(points, see(camera, points, random), image_size_px=SIZE_PX)
    assert {"skew_px", "k1"} <= set(result.lens_parameters)
    assert squared_error_of_centre(result, camera) < chi2.ppf(0.9999, 3)


@pytest.mark.parametrize("seed", range(3))
def test_a_skew_that_gains_nothing_beside_what_is_freed_later_is_held_again(seed: int) -> None:
    """A long lens that is not centred seems at first to need a skew alone."""
    lens = Intrinsics(
        focal_length_px=6600.0,
        image_size_px=(1280, 1024),
        principal_point_px=(1430.0, 745.0),
        distortion=(0.24, -0.62, 0.012, 0.031, 0.0),
    )
    camera = Camera.from_degrees(
        lens,
        pan_deg=-100.0,
        tilt_deg=73.0,
        swing_deg=-100.0,
        distance_mm=584.0,
        aim_mm=(105.0, 13.0),
    )
    random = np.random.default_rng([14, seed])
    points = random.uniform([0, 0, -12], [68, 66, 0], (430, 3))
    result = calibrate_points(points, see(camera, points, random), image_size_px=lens.image_size_px)
    assert result.overall_status is Status.CONVERGED
    assert result.lens_parameters[4:8] == ("k1", "k2", "p1", "p2")
    assert "skew_px" not in result.lens_parameters
    assert squared_error_of_centre(result, camera) < chi2.ppf(0.9999, 3)


def test_points_that_ask_for_a_lens_that_is_held_are_suspect_and_say_for_what() -> None:
    random = np.random.default_rng(11)
    points = block(random)
    bent = see(camera_of(TABLE_1["left"], DISTORTED_LENS), points, random)
    skewed = see(camera_of(TABLE_1["left"], SKEWED), points, random)
    for uv_px, cause in ((bent, "Add k1 to `free`"), (skewed, "Add skew_px to `free`")):
        affine_fit = calibrate_points(points, uv_px, image_size_px=SIZE_PX, free=AFFINE_PARAMETERS)
        pose_fit = calibrate_points(points, uv_px, LENS, systematics=Systematics())
        default_fit = calibrate_points(points, uv_px, LENS)
        for result in (affine_fit, pose_fit, default_fit):
            assert result.overall_status is Status.SUSPECT
            assert len(result.notes) >= 1
        assert "contradict the given lens" in affine_fit.notes[0]
        assert cause in affine_fit.notes[0]
    right = calibrate_points(points, bent, DISTORTED_LENS, systematics=Systematics())
    assert right.overall_status is Status.CONVERGED
    assert right.notes == ()


def test_an_aim_that_is_held_and_is_not_is_suspect() -> None:
    random = np.random.default_rng(12)
    points = block(random)
    off_aim_camera = camera_of(TABLE_1["left"], LENS, (3.0, -2.0))
    exact = Systematics()
    for camera, status in (
        (camera_of(TABLE_1["left"]), Status.CONVERGED),
        (off_aim_camera, Status.SUSPECT),
    ):
        uv_px = see(camera, points, random)
        result = calibrate_points(points, uv_px, LENS, pose_model="aimed", systematics=exact)
        assert result.overall_status is status
    numbers = re.findall(r"[-\d.]+", result.notes[0].split("+-")[0])
    np.testing.assert_allclose([float(number) for number in numbers], [3.0, -2.0], atol=0.1)


@pytest.mark.parametrize(("sigmas", "status"), [(2.0, Status.CONVERGED), (9.0, Status.SUSPECT)])
def test_a_lens_is_refuted_beyond_what_is_said_of_it(sigmas: float, status: Status) -> None:
    """A rigid motion absorbs much of the error: a principal point acts nearly as a turn."""
    sigma_px = 10.0
    lens = Intrinsics(
        focal_length_px=LENS.focal_length_px,
        image_size_px=SIZE_PX,
        principal_point_px=LENS.principal_point_px + sigmas * np.array([sigma_px, -sigma_px]),
    )
    random = np.random.default_rng(13)
    points = block(random, 250)
    uv_px = see(camera_of(TABLE_1["left"], lens), points, random)
    stated = Systematics(lens_covariance=np.diag([25.0, 25.0, sigma_px**2, sigma_px**2]))
    result = calibrate_points(points, uv_px, LENS, systematics=stated)
    assert result.overall_status is status
    assert all("contradict the given lens" in note for note in result.notes)
