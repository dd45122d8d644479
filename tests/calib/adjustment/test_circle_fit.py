"""Laws of the circle fit: derivatives, recovery of the truth, symmetries, coverage."""

import dataclasses

import jax
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.calib.simulated import (
    DISTORTED_LENS,
    EXACT,
    LENS,
    TABLE_1,
    camera_of,
    reference_sheet,
    simulated_detection,
)
from trinoc.calib import Detection, Status, calibrate_detections
from trinoc.calib.adjustment.adjustment import Adjustment
from trinoc.calib.adjustment.single_camera import fit_single_camera, observe_single_camera
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry import Pose
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel

SHEET = reference_sheet()
exact_centres = jax.jit(jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0)))
PANS = st.floats(-179.0, 179.0)
TILTS = st.floats(15.0, 80.0)


def pose_of(values: tuple[float, ...], aim_mm: tuple[float, float] = (0.0, 0.0)) -> Pose:
    return Pose.from_parameters(np.array([*np.radians(values[:3]), values[3], *aim_mm]))


def problem_of(lens: Intrinsics, pose: Pose) -> Problem:
    """One camera before the whole sheet, which shows each circle at the pixel (0, 0)."""
    count = len(SHEET)
    identities = np.broadcast_to(np.eye(2), (count, 2, 2))
    no_lines = np.full((2, 3), np.nan)
    detection = Detection(
        np.arange(count), np.zeros((count, 2)), identities, identities, no_lines, lens.image_size_px
    )
    camera = SheetCamera("one", detection, lens, None, pose)
    return sheet_problem([camera], SHEET, SheetPriors(PoseModel.AIM_FREE, EXACT))


@pytest.mark.parametrize("lens", [LENS, DISTORTED_LENS])
@given(pan=PANS, tilt=TILTS, swing=PANS)
def test_prediction_is_that_of_the_conic(
    lens: Intrinsics, pan: float, tilt: float, swing: float
) -> None:
    values = (pan, tilt, swing, 480.0)
    camera, pose = camera_of(values, lens, (3.0, -2.0)), pose_of(values, (3.0, -2.0))
    # A lens bends an ellipse by as much as its centre and the middle of its area are apart.
    np.testing.assert_allclose(
        errors_px(problem_of(lens, pose))[0],
        exact_centres(camera, SHEET.centres_mm, SHEET.radius_mm),
        atol=1e-9 if lens is LENS else 2e-4,
    )


@settings(max_examples=10)
@given(pan=PANS, tilt=TILTS, swing=PANS, distance=st.floats(300.0, 900.0), free=st.booleans())
def test_without_noise_the_camera_is_recovered(
    pan: float, tilt: float, swing: float, distance: float, free: bool
) -> None:
    aim = (9.0, -6.0) if free else (0.0, 0.0)
    camera = camera_of((pan, tilt, swing, distance), LENS, aim)
    detection = simulated_detection(camera, SHEET, seed=0, sigma_px=1e-9)
    result = calibrate_detections(
        {"a": detection}, SHEET, LENS, pose_model="aim-free" if free else "aimed", systematics=EXACT
    )
    np.testing.assert_allclose(
        result.rig["a"].cam_from_world, camera.cam_from_world, rtol=1e-7, atol=1e-7
    )
    assert result.status == {"a": Status.CONVERGED}


def test_hidden_lines_change_nothing_but_the_start() -> None:
    camera = camera_of(TABLE_1["left"])
    results = [
        calibrate_detections(
            {"a": simulated_detection(camera, SHEET, seed=4, lines_seen=lines_seen)},
            SHEET,
            LENS,
            systematics=EXACT,
        )
        for lines_seen in (True, False)
    ]
    np.testing.assert_allclose(results[0].values, results[1].values, rtol=1e-8)


def test_order_of_cameras_does_not_matter() -> None:
    detections = {
        name: simulated_detection(camera_of(values), SHEET, seed=k)
        for k, (name, values) in enumerate(TABLE_1.items())
    }
    forward = calibrate_detections(detections, SHEET, LENS, systematics=EXACT)
    backward = calibrate_detections(
        dict(reversed(detections.items())), SHEET, LENS, systematics=EXACT
    )
    by_name = dict(zip(backward.parameters, backward.values, strict=True))
    for parameter, value in zip(forward.parameters, forward.values, strict=True):
        assert value == pytest.approx(by_name[parameter], rel=1e-12)
        assert forward.sigma(parameter) == pytest.approx(backward.sigma(parameter), rel=1e-9)


def test_turning_the_sheet_turns_the_pan() -> None:
    camera = camera_of(TABLE_1["upper"])
    detection = simulated_detection(camera, SHEET, seed=5)
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    turned = Pattern(
        name="turned",
        centres_mm=SHEET.centres_mm @ quarter.T,
        radius_mm=SHEET.radius_mm,
        inner_radius_mm=SHEET.inner_radius_mm,
        lattice=np.round(SHEET.lattice @ quarter.T).astype(int),
        line_width_mm=SHEET.line_width_mm,
        line_half_length_mm=SHEET.line_half_length_mm,
        line_style=SHEET.line_style,
        line_gap_mm=SHEET.line_gap_mm,
    )
    plain = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    # The line along the old X is the new Y, and the line along the new X is the old -Y.
    swapped = simulated_detection(camera, SHEET, seed=5)
    swapped = dataclasses.replace(swapped, lines_px=detection.lines_px[::-1])
    moved = calibrate_detections({"a": swapped}, turned, LENS, systematics=EXACT)
    np.testing.assert_allclose(moved.values - plain.values, [90.0, 0.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(moved.covariance, plain.covariance, rtol=1e-4, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(("pose_model", "count"), [("aimed", 4), ("aim-free", 6)])
def test_errors_scatter_as_the_covariance_says(pose_model: str, count: int) -> None:
    camera, trials = camera_of(TABLE_1["right"]), 300
    detections = {str(k): simulated_detection(camera, SHEET, seed=100 + k) for k in range(trials)}
    result = calibrate_detections(detections, SHEET, LENS, pose_model=pose_model, systematics=EXACT)
    errors = result.values.reshape(trials, count)
    errors = errors - np.array([*TABLE_1["right"], 0.0, 0.0])[:count]
    blocks = result.covariance.reshape(trials, count, trials, count)
    squared = [e @ np.linalg.solve(blocks[k, :, k], e) for k, e in enumerate(errors)]
    # A mean of `trials` chi-squares of `count` degrees of freedom, within four deviations.
    assert abs(np.mean(squared) / count - 1) < 4 * np.sqrt(2 / (count * trials))
    reported_sigmas = np.sqrt(np.diag(result.covariance)).reshape(trials, count)
    np.testing.assert_allclose(np.std(errors / reported_sigmas, axis=0), 1.0, atol=0.17)


def test_a_camera_that_looks_straight_down_is_calibrated() -> None:
    camera = camera_of((0.0, 90.0, 20.0, 480.0))
    detection = simulated_detection(camera, SHEET, seed=2)
    result = calibrate_detections({"a": detection}, SHEET, LENS, systematics=EXACT)
    np.testing.assert_allclose(
        result.rig["a"].cam_from_world, camera.cam_from_world, atol=0.05, rtol=0
    )
    assert "pan_deg and swing_deg" in " ".join(result.fits["a"].notes)
    assert np.isfinite(result.sigma("a.tilt_deg"))


def test_what_places_are_said_to_err_by_matters_not_where_they_err_by_more() -> None:
    """The covariance of one camera follows the errors that its circles show."""
    shown = simulated_detection(camera_of(TABLE_1["left"]), SHEET, seed=6, sigma_px=0.1)

    def fit(share: float) -> Adjustment:
        stated = share**2 * shown.covariance_px2
        detection = dataclasses.replace(shown, covariance_px2=stated)
        adjustment = fit_single_camera(detection, SHEET, LENS, PoseModel.AIMED)
        assert adjustment is not None
        return adjustment

    full, half, tenth = fit(1.0), fit(0.5), fit(0.1)
    assert half.used[0].all()
    assert tenth.used[0].all()
    np.testing.assert_allclose(half.covariance, tenth.covariance, rtol=1e-4)
    # Chi-square over its degrees of freedom, in numbers of 0.1 px.
    scatter = tenth.reduced_chi_square[0] * 0.1**2
    assert 0.6 < scatter < 1.5
    np.testing.assert_allclose(tenth.covariance, scatter * full.covariance, rtol=1e-3)
    # The test of which parameters are determined uses the stated sigmas.
    observed_covariances = [observe_single_camera(each)[1].covariance for each in (full, tenth)]
    np.testing.assert_allclose(observed_covariances[1], 0.1**2 * observed_covariances[0], rtol=1e-3)
