"""Undetermined parameters are named and refused, and the advised image determines them."""

import dataclasses
import re

import numpy as np
import pytest

from tests.calib.simulated_lens import (
    LENS,
    SHEET,
    SIZE_PX,
    detection,
    detections,
    fitted_names,
    good_poses,
    lens_sigmas,
    lens_values,
    pose,
)
from trinoc.calib import CalibrationResult, Detection, Status, next_shot
from trinoc.calib.advice.foreseen_shots import candidate_shots
from trinoc.calib.advice.next_shot import covariance_with_weak_prior
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import FreeLensParameters
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.lenses.polynomial import BrownConrady

SQUARE = [
    pose(tilt_deg=0, azimuth_deg=0, roll_deg=9 * k, distance_mm=420 + 20 * k, aside=(0.02, -0.01))
    for k in range(8)
]

THE_LENS = BrownConrady.from_parameters(LENS)


def test_pictures_square_to_the_camera_leave_focal_length_and_distance_open():
    with pytest.raises(CalibrationError, match="parallel to the image plane") as caught:
        calibrate_intrinsics(detections(SQUARE), SHEET)
    result = caught.value.result
    assert isinstance(result, CalibrationResult)
    assert result.overall_status is Status.RANK_DEFICIENT
    assert not result.has_rig
    with pytest.raises(CalibrationError, match="No rig was determined"):
        _ = result.lens
    assert {"camera.fx_px", "camera.fy_px"} <= set(result.gauge)
    assert np.isnan(lens_values(result)[:2]).all()
    assert np.isnan(result.sigma("fx_px"))
    assert re.search("Next, hold the board .* tilted", str(caught.value))


def test_rounding_below_no_information_is_none():
    result = calibrate_intrinsics(detections(SQUARE), SHEET, throw=False)
    assert result.solved_problem is not None
    ended, information = result.solved_problem, compute_information(result.solved_problem.problem)

    def advise(smallest_eigenvalue: float) -> str:
        covariance = covariance_with_weak_prior(
            information._replace(shot_information=with_smallest_eigenvalue(smallest_eigenvalue))
        )
        advice = next_shot(
            dataclasses.replace(result, solved_problem=ended._replace(covariance=covariance))
        )
        assert advice is not None
        return advice.sentence

    def with_smallest_eigenvalue(smallest_eigenvalue: float) -> np.ndarray:
        total, free = information.shot_information.sum(axis=0), information.free
        prior = np.zeros_like(total)
        prior[np.ix_(free, free)] = information.prior
        eigenvalues, directions = np.linalg.eigh((total + prior)[np.ix_(free, free)])
        changed = (directions * [smallest_eigenvalue, *eigenvalues[1:]]) @ directions.T
        total[np.ix_(free, free)] = changed - information.prior
        return total[None]

    assert advise(0.0) == advise(-1.0)


def test_one_picture_does_not_pass_for_a_lens():
    result = calibrate_intrinsics(detections(good_poses()[:1]), SHEET, distortion=0, throw=False)
    exact = calibrate_intrinsics(detections(good_poses()), SHEET)
    assert result.overall_status is not Status.CONVERGED or (
        result.sigma("fx_px") > 10 * exact.sigma("fx_px")
    )


def test_a_held_principal_point_lets_one_picture_do():
    straight = np.append(LENS[:2], [255.5, 239.5, 0, 0, 0, 0, 0])
    image_detections = [detection(good_poses()[2], values=straight)]
    result = calibrate_intrinsics(image_detections, SHEET, distortion=0, principal_point="centre")
    assert fitted_names(result) == ("fx_px", "fy_px")
    assert (np.abs(lens_values(result) - straight)[:2] < 4 * lens_sigmas(result)[:2]).all()


@pytest.mark.slow
@pytest.mark.parametrize("poses", [good_poses()[:3], good_poses(seed=3), SQUARE[:4]])
def test_the_advised_picture_lowers_the_sigma_that_it_promises(poses):
    before = calibrate_intrinsics(detections(poses), SHEET, throw=False)
    advice = next_shot(before)
    assert advice is not None
    parameter = advice.parameter
    assert parameter is not None
    # The advice was made for the lens as estimated; the true one images the sheet alike.
    taken = detection(advice.world_from_board, seed=77)
    after = calibrate_intrinsics([*detections(poses), taken], SHEET, throw=False)
    sigma = after.sigma(parameter)
    if np.isfinite(advice.sigma_now[parameter]):
        assert advice.sigma_then[parameter] < advice.sigma_now[parameter]
        assert sigma < before.sigma(parameter)
        assert sigma == pytest.approx(advice.sigma_then[parameter], rel=0.3)
    else:
        assert after.overall_status is Status.CONVERGED
        assert np.isfinite(sigma)


def test_circles_near_the_middle_leave_the_corners_to_extrapolation():
    far = [
        pose(tilt_deg=35, azimuth_deg=45 * k, roll_deg=10 * k, distance_mm=900) for k in range(8)
    ]
    result = calibrate_intrinsics(detections(far), SHEET, throw=False)
    assert any("distortion is extrapolated beyond" in note for note in result.notes)


def candidates():
    """Candidate poses of the sheet in front of a camera of THE_LENS."""
    sheet_detection = detection(good_poses()[0])
    lens_alone = start_problem(
        [BoardObservation(0, 0, sheet_detection, np.ones(len(sheet_detection), dtype=bool))],
        SHEET,
        [THE_LENS],
        np.eye(3, 4)[None],
        good_poses()[0][None],
        [SIZE_PX],
        FreeLensParameters(np.zeros(1, dtype=int), np.ones((1, 9), dtype=bool)),
        Systematics(),
    )
    return candidate_shots(lens_alone)


def test_every_candidate_shows_the_sheet_from_its_printed_side():
    for candidate in candidates():
        cam = candidate.rig_from_board
        np.testing.assert_allclose(cam.rotation @ cam.rotation.T, np.eye(3), atol=1e-12)
        assert (cam.transform_points(np.pad(SHEET.centres_mm, ((0, 0), (0, 1))))[:, 2] > 0).all()
        assert cam.centre_world_mm[2] > 0


def test_the_words_of_a_candidate_are_those_of_its_pose():
    poses = {candidate.instruction: candidate.rig_from_board for candidate in candidates()}
    for side, axis, sign in (("left", 0, -1), ("right", 0, 1), ("upper", 1, -1), ("lower", 1, 1)):
        instruction = next(
            text for text in poses if f"its {side} side" in text and "in the middle" in text
        )
        points = poses[instruction].transform_points(np.pad(SHEET.centres_mm, ((0, 0), (0, 1))))
        uv = np.array([THE_LENS.project_ray(p) for p in points])
        aside = sign * (uv[:, axis] - uv[:, axis].mean())
        assert np.corrcoef(aside, points[:, 2])[0, 1] < -0.9


def test_inputs_that_cannot_be_right_are_refused():
    image_detections = detections(good_poses())
    with pytest.raises(InputError, match="No image"):
        calibrate_intrinsics([], SHEET)
    with pytest.raises(InputError, match="are the same"):
        calibrate_intrinsics([*image_detections, image_detections[3]], SHEET)
    with pytest.raises(InputError, match="640 x 480"):
        calibrate_intrinsics(image_detections, SHEET, image_size_px=(640, 480))
    with pytest.raises(InputError, match="distortion"):
        calibrate_intrinsics(image_detections, SHEET, distortion=3)
    with pytest.raises(InputError, match="principal_point"):
        calibrate_intrinsics(image_detections, SHEET, principal_point="fixed")
    with pytest.raises(InputError, match="aspect"):
        calibrate_intrinsics(image_detections, SHEET, aspect="square")


def test_pictures_of_another_camera_are_refused():
    other = LENS.copy()
    other[:2] *= 1.6
    mixed = detections(good_poses()[:4]) + detections(good_poses(1)[:4], values=other)
    with pytest.raises(CalibrationError, match="one camera at one zoom"):
        calibrate_intrinsics(mixed, SHEET)


def test_a_picture_with_too_few_circles_is_named_and_left_out():
    image_detections = detections(good_poses())
    few = image_detections[0]
    image_detections[0] = Detection(
        circle_index=few.circle_index[:3],
        centres_px=few.centres_px[:3],
        covariance_px2=few.covariance_px2[:3],
        shape_px2=few.shape_px2[:3],
        lines_px=few.lines_px,
        image_size_px=few.image_size_px,
    )
    result = calibrate_intrinsics(image_detections, SHEET)
    assert list(result.failures) == ["camera, picture 1"]
    assert result.shots == tuple(f"picture {k}" for k in range(2, 9))
    assert "picture 1: only 3 circles" in result.summary()
