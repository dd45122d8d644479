"""Lenses and cameras are estimated together with true sigmas, and impossible inputs are named."""

import numpy as np
import pytest

from tests.calib.made_shots import BOARD, LENSES, cam_from_rig, lens_of, shots
from trinoc.calib import projection_sigma
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io.rig_json import load_rig
from trinoc.io.saving import save

EXACT = Systematics()


@pytest.fixture(scope="module")
def calibration():
    return calibrate_rig(shots(), BOARD, systematics=EXACT)


def relative(poses, first, second):
    """Pose (3, 4) second_from_first."""
    rotation = poses[second][:, :3] @ poses[first][:, :3].T
    return np.column_stack([rotation, poses[second][:, 3] - rotation @ poses[first][:, 3]])


def test_lenses_and_cameras_are_found_within_their_sigmas(calibration):
    assert calibration.overall_status is Status.CONVERGED
    names = [f"{camera}.{name}" for camera in LENSES for name in lens_of(camera).parameter_names]
    truth = np.concatenate(list(LENSES.values()))
    free = np.array([calibration.sigma(name) > 0 for name in names])
    assert free.sum() >= 24
    rows = [calibration.parameters.index(name) for name in np.array(names)[free]]
    error = calibration.values[rows] - truth[free]
    chi_square = error @ np.linalg.solve(calibration.covariance[np.ix_(rows, rows)], error)
    # Chi-square of 24 to 27: between its quantiles of 1e-4.
    assert 7.0 < chi_square < 63.0
    poses = {name: np.asarray(calibration.rig[name].cam_from_world) for name in LENSES}
    exact = {name: cam_from_rig(name) for name in LENSES}
    for other in ("left", "right"):
        step, true = relative(poses, "middle", other), relative(exact, "middle", other)
        np.testing.assert_allclose(step[:, :3], true[:, :3], atol=1.5e-2)
        np.testing.assert_allclose(step[:, 3], true[:, 3], atol=5.0)


def test_what_is_true_of_the_fit_is_said(calibration):
    assert 0.8 < calibration.reduced_chi_square < 1.2
    assert all(0.85 < fit.sigma_factor < 1.15 for fit in calibration.fits.values())
    assert calibration.halves is not None
    assert 0.5 < calibration.halves.ratio < 1.6
    assert "halves of the shots" in calibration.summary()
    assert calibration.failures == {}
    assert calibration.refused == ()
    sigma = projection_sigma(calibration.rig, "left", 600.0)
    assert sigma.sigma_px.shape == (25,)
    assert (sigma.sigma_px > 0).all()
    assert sigma.sigma_px.max() < 5.0
    assert projection_sigma(calibration.rig, "left", 6000.0).sigma_px.max() > sigma.sigma_px.max()


def test_the_chi_square_of_the_rig_is_the_mean_of_its_cameras(calibration):
    numbers = [fit.used.sum() for fit in calibration.fits.values()]
    chi_squares = [fit.reduced_chi_square for fit in calibration.fits.values()]
    mean = np.average(chi_squares, weights=numbers)
    np.testing.assert_allclose(mean, calibration.reduced_chi_square, rtol=1e-9)


def test_the_world_may_be_a_camera(calibration):
    rig = calibrate_rig(shots(), BOARD, systematics=EXACT, world="middle").rig
    assert rig is not None
    np.testing.assert_allclose(np.asarray(rig["middle"].cam_from_world), np.eye(3, 4), atol=1e-9)
    poses = {name: np.asarray(rig[name].cam_from_world) for name in LENSES}
    before = {name: np.asarray(calibration.rig[name].cam_from_world) for name in LENSES}
    np.testing.assert_allclose(
        relative(poses, "left", "right"), relative(before, "left", "right"), atol=1e-4
    )
    assert "middle.turn_x_deg" not in rig.parameters
    with pytest.raises(InputError, match="but must be a camera"):
        calibrate_rig(shots(), BOARD, systematics=EXACT, world="attic")


def test_the_order_of_cameras_does_not_matter(calibration):
    detections, world = shots(), calibration.world.removeprefix("the board in ")
    turned = {name: detections[name] for name in ("right", "left", "middle")}
    other = calibrate_rig(turned, BOARD, systematics=EXACT, world=world)
    rows = [other.parameters.index(name) for name in calibration.parameters]
    sigma = np.sqrt(np.diag(calibration.covariance))
    assert np.all(np.abs(other.values[rows] - calibration.values) <= 0.02 * sigma + 1e-9)
    np.testing.assert_allclose(
        np.sqrt(np.diag(other.covariance))[rows], sigma, rtol=0.01, atol=1e-9
    )


def test_rig_json_holds_the_covariance_of_poses_and_lenses(calibration, tmp_path):
    save(calibration, tmp_path / "rig.json")
    back = load_rig(tmp_path / "rig.json")
    assert back.parameters == calibration.rig.parameters
    assert {"left.pan_deg", "left.fx_px", "right.k1"} <= set(back.parameters)
    np.testing.assert_allclose(back.covariance, calibration.rig.covariance, rtol=1e-12)
    assert back.sigma("left.fx_px") == pytest.approx(calibration.sigma("left.fx_px"))


def test_a_picture_of_another_moment_is_refused_by_name(calibration):
    detections = shots()
    detections["left"][3] = detections["left"][5]
    spoilt = calibrate_rig(detections, BOARD, systematics=EXACT)
    assert calibration.refused == ()
    (sentence,) = spoilt.refused
    assert sentence.startswith('shot 4: "left" shows the board')
    for name in ("left.fx_px", "right.cx_px"):
        assert abs(spoilt.value(name) - calibration.value(name)) < 5 * calibration.sigma(name)


def test_corners_located_wrongly_are_left_out():
    detections = shots()
    spoilt = np.array(detections["right"][2].centres_px)
    spoilt[4] += 30.0
    detections["right"][2] = type(detections["right"][2])(
        **{**vars(detections["right"][2]), "centres_px": spoilt}
    )
    (sentence,) = calibrate_rig(detections, BOARD, systematics=EXACT).refused
    assert sentence.startswith('shot 3: "right": 1 of')


def test_cameras_that_never_share_a_shot_are_chained():
    detections = shots()
    detections["left"][::2] = [None] * 4
    detections["right"][1::2] = [None] * 3
    rig = calibrate_rig(detections, BOARD, systematics=EXACT).rig
    assert rig is not None
    poses = {name: np.asarray(rig[name].cam_from_world) for name in LENSES}
    exact = {name: cam_from_rig(name) for name in LENSES}
    step, true = relative(poses, "left", "right"), relative(exact, "left", "right")
    np.testing.assert_allclose(step[:, :3], true[:, :3], atol=1e-2)
    assert rig.sigma("left.fx_px") > 0


def test_cameras_that_nothing_connects_are_named_in_groups():
    detections = shots()
    detections["left"][4:] = [None] * 3
    detections["middle"][:4] = [None] * 4
    detections["right"][:4] = [None] * 4
    with pytest.raises(CalibrationError, match="groups are left; middle, right"):
        calibrate_rig(detections, BOARD)


def test_cameras_out_of_step_by_one_are_told_so():
    detections = shots(cameras=("left", "right"))
    detections["right"] = [None, *detections["right"][:-1]]
    with pytest.raises(CalibrationError, match="1 shot earlier, so the shots of the two"):
        calibrate_rig(detections, BOARD)


def test_a_camera_that_sees_nothing_is_named():
    detections = shots()
    detections["right"] = [np.full((480, 640), 128, np.uint8)]
    with pytest.raises(CalibrationError, match='found in no image of camera "right"'):
        calibrate_rig(detections, BOARD)


def test_shots_that_determine_nothing_are_told_why():
    with pytest.raises(CalibrationError, match="one image of a plane determines only"):
        calibrate_rig(shots(count=1), BOARD)


def test_known_lenses_are_held():
    lenses = {name: Intrinsics.of_lens(lens_of(name), (640, 480)) for name in LENSES}
    result = calibrate_rig(shots(count=1), BOARD, lens=lenses, systematics=EXACT)
    assert result.overall_status is Status.CONVERGED
    assert result.has_rig
    assert result.sigma("left.fx_px") == 0.0
    poses = {name: np.asarray(result.rig[name].cam_from_world) for name in LENSES}
    exact = {name: cam_from_rig(name) for name in LENSES}
    step, true = relative(poses, "middle", "left"), relative(exact, "middle", "left")
    np.testing.assert_allclose(step[:, :3], true[:, :3], atol=5e-3)


def test_an_image_of_another_size_is_refused_alone(calibration):
    detections = shots()
    other = detections["left"][1]
    detections["left"][1] = type(other)(**{**vars(other), "image_size_px": (480, 640)})
    spoilt = calibrate_rig(detections, BOARD, systematics=EXACT)
    ((where, why),) = spoilt.failures.items()
    assert where == "left, shot 2"
    assert "480 x 640 pixels" in why
    assert abs(
        spoilt.value("left.fx_px") - calibration.value("left.fx_px")
    ) < 4 * calibration.sigma("left.fx_px")
