"""Errors of pose and lens propagate to epipolar lines and points as those of moved cameras do."""

import numpy as np
import pytest

from tests.calib.simulated import LENS, TABLE_1, camera_of, reference_sheet, simulated_detection
from trinoc.calib import (
    calibrate_detections,
    epipolar_sigma,
    point_covariance,
    projection_sigma,
)
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.propagation import field_grid_px, field_sigma_px
from trinoc.calib.uncertainty.systematics import Systematics, data_sheet_covariance
from trinoc.geometry import (
    epipolar_distance_px,
    fundamental_matrix,
    sheet_from_pixel,
    triangulate_point,
)
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.precision import in_float64
from trinoc.numerics.tables import with_field

SHEET = reference_sheet()
NAMES = PARAMETER_NAMES + AFFINE_PARAMETERS
# A step of each parameter that moves pictures by about a pixel.
UNIT = np.array([0.1, 0.1, 0.1, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0, 1.0])
POINT_MM = np.array([20.0, -10.0, 15.0])


def lens_of(values: np.ndarray) -> Intrinsics:
    fx, fy, cx, cy = values
    return Intrinsics(
        focal_length_px=(fx, fy), principal_point_px=(cx, cy), image_size_px=LENS.image_size_px
    )


def moved(change: np.ndarray) -> Rig:
    """The rig of Table 1 after a change (3, 10) of its parameters."""
    lens_values = np.concatenate([LENS.focal_length_px, LENS.principal_point_px])
    cameras = {}
    for (name, values), step in zip(TABLE_1.items(), change, strict=True):
        pose = np.concatenate([values, [0.0, 0.0]]) + step[:6]
        camera = camera_of(tuple(pose[:4]), lens_of(lens_values + step[6:]), tuple(pose[4:]))
        cameras[name] = Camera(camera.intrinsics, camera.pose)
    return Rig(cameras)


def known_along(direction: np.ndarray) -> Rig:
    """Rig whose only error is a normal length along one direction of all parameters."""
    names = [f"{camera}.{key}" for camera in TABLE_1 for key in NAMES]
    cameras = dict(moved(np.zeros((3, 10))).items())
    vector = direction.reshape(-1)
    return Rig(cameras, parameters=names, covariance=np.outer(vector, vector))


@in_float64
def images_of(rig: Rig, point_mm: np.ndarray) -> np.ndarray:
    images = rig.matrices_px @ np.append(point_mm, 1.0)
    return images[:, :2] / images[:, 2:]


@in_float64
def triangulated(rig: Rig) -> np.ndarray:
    exact = images_of(moved(np.zeros((3, 10))), POINT_MM)
    return np.asarray(triangulate_point(rig.matrices_px, exact, np.ones(3)))


@in_float64
def distance_px(rig: Rig, uv_px: np.ndarray) -> float:
    """Distance of a point's pixel in "left" from the epipolar line of its pixel in "upper"."""
    true = moved(np.zeros((3, 10)))
    point_mm = np.append(np.asarray(sheet_from_pixel(true["upper"], uv_px)), 0.0)
    match = images_of(true, point_mm)[list(TABLE_1).index("left")]
    fundamental = fundamental_matrix(rig["left"].matrix_px, rig["upper"].matrix_px)
    return float(epipolar_distance_px(fundamental, match, uv_px))


@pytest.mark.parametrize("seed", range(4))
def test_one_direction_of_errors_is_that_of_moved_cameras(seed: int) -> None:
    direction = np.random.default_rng(seed).normal(size=(3, 10)) * UNIT
    step = 1e-3 * direction
    rig = known_along(direction)
    by_step = (triangulated(moved(step)) - triangulated(moved(-step))) / 2e-3
    expected = np.outer(by_step, by_step)
    np.testing.assert_allclose(
        point_covariance(rig, POINT_MM), expected, rtol=1e-3, atol=1e-4 * np.trace(expected)
    )
    field = epipolar_sigma(rig, "upper", "left")
    for row in (0, 7, 12, 24):
        uv = field.uv_px[row]
        slope = (distance_px(moved(step), uv) - distance_px(moved(-step), uv)) / 2e-3
        assert field.sigma_px[row] == pytest.approx(abs(slope), rel=1e-3, abs=1e-4)


@pytest.mark.slow
def test_points_of_calibrations_with_other_lenses_scatter_as_their_rigs_say() -> None:
    """Errors of pose and lens are correlated: points near the sheet are more exact than cameras."""
    random = np.random.default_rng(5)
    covariance = data_sheet_covariance(LENS)[:4, :4]
    systematics = Systematics(lens_covariance=dict.fromkeys(TABLE_1, covariance))
    factor = np.linalg.cholesky(covariance)
    lens_values = np.concatenate([LENS.focal_length_px, LENS.principal_point_px])
    detections = [
        {
            name: simulated_detection(camera_of(values), SHEET, seed=100 * k + v, sigma_px=0.05)
            for v, (name, values) in enumerate(TABLE_1.items())
        }
        for k in range(40)
    ]
    squared = []
    for rig_detections in detections:
        lens = {name: lens_of(lens_values + factor @ random.normal(size=4)) for name in TABLE_1}
        rig = calibrate_detections(rig_detections, SHEET, lens, systematics=systematics).rig
        error = triangulated(rig) - POINT_MM
        reported_covariance = point_covariance(rig, POINT_MM)
        squared.append(error @ np.linalg.solve(reported_covariance, error))
        assert np.sqrt(np.trace(reported_covariance)) < 0.1 * rig.sigma("upper.distance_mm")
    # The mean of 40 chi-square numbers of three degrees of freedom, within four sigmas.
    assert abs(np.mean(squared) - 3) < 4 * np.sqrt(2 * 3 / 40)


def test_an_error_of_the_principal_point_is_that_of_every_pixel() -> None:
    rig, names = moved(np.zeros((3, 10))), [f"left.{key}" for key in NAMES]
    of_axis = np.array([0.3 * name.endswith(("cx_px", "cy_px")) for name in names])
    uncertain_rig = Rig(dict(rig.items()), parameters=names, covariance=np.diag(of_axis**2))
    sigmas = projection_sigma(uncertain_rig, "left", 500.0).sigma_px
    np.testing.assert_allclose(sigmas, 0.3, rtol=1e-9)


def test_places_beyond_the_image_circle_of_a_fisheye_have_no_sigma():
    """The image corners lie 593 px from the middle, where no ray of this lens has an image."""
    lens = Intrinsics(
        image_size_px=(848, 800),
        focal_length_px=290.0,
        distortion=(0.04, -0.028, 0.0, 0.0),
        distortion_model="kannala_brandt",
    )
    camera = Camera.from_degrees(lens, pan_deg=10, tilt_deg=50, swing_deg=0, distance_mm=400)
    uncertain_rig = Rig(
        {"a": camera}, parameters=["a.fx_px", "a.k1"], covariance=np.diag([0.01, 1e-8])
    )
    sigma = projection_sigma(uncertain_rig, "a", 400.0).sigma_px.reshape(5, 5)
    assert np.isnan(sigma[[0, 0, -1, -1], [0, -1, 0, -1]]).all()
    assert np.isfinite(sigma[1:-1, 1:-1]).all()
    assert np.nanmax(sigma) < 10.0
    covariance = np.diag([0.01, 0.01, 0.0, 0.0, 1e-8, 0.0, 0.0, 0.0])
    of_lens = np.asarray(field_sigma_px(lens.lens, covariance, field_grid_px((848, 800))))
    np.testing.assert_array_equal(np.isnan(of_lens), np.isnan(sigma))
    assert np.nanmax(of_lens) < 10.0


def test_typical_errors_follow_the_tuning() -> None:
    lens = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.016, 0.014), image_size_px=(512, 480))
    usual = Systematics.typical({"a": lens})
    doubled = with_field(TUNING, "uncertainty.principal_point", 0.04)
    other = Systematics.typical({"a": lens}, tuning=with_field(doubled, "uncertainty.aim_mm", 7.0))
    assert (usual.aim_sigma_mm, other.aim_sigma_mm) == (20.0, 7.0)
    factors = [systematics.lens_factors({"a": lens})["a"] for systematics in (usual, other)]
    variances = [np.diag(factor @ factor.T) for factor in factors]
    np.testing.assert_allclose(variances[1] / variances[0], [1, 1, 4, 4, 1])
