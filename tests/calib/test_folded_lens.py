"""A fitted lens that folds the image is refused, or usable up to the fold, with advice."""

from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import trinoc
from tests.calib import made_shots
from tests.calib.made_shots import (
    BOARD,
    SIZE_PX,
    board_poses,
    detection,
    lens_of,
    shots,
)
from tests.calib.problem.made_problem import problem
from tests.calib.simulated_lens import fitted_names
from trinoc.calib import Detection
from trinoc.calib.folded_lens import assess_folds, fit_wider_model
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.problem.problem import with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, end_of_fit
from trinoc.calib.result.calibration import Status
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.shots_fit import ShotsFit
from trinoc.calib.starts.placing import InitialRig
from trinoc.errors import CalibrationError
from trinoc.geometry.intrinsics import Intrinsics, describe_fold
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import Rational


def test_a_distortion_seen_in_the_middle_alone_is_not_a_result(monkeypatch):
    folds = np.array([350.0, 350.0, 319.5, 239.5, -0.27, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setitem(made_shots.LENSES, "left", folds)
    detections = shots(count=8, cameras=("left",))
    with pytest.raises(CalibrationError, match="fewer coefficients") as raised:
        calibrate_rig(detections, BOARD, distortion=1)
    assert str(raised.value).startswith('The fitted distortion of "left" folds the image 2')
    result = calibrate_rig(detections, BOARD, distortion=1, throw=False)
    assert result.overall_status is Status.SUSPECT
    assert not result.has_rig
    assert result.halves is None
    assert str(raised.value) in result.summary()
    assert calibrate_rig(detections, BOARD, distortion=0, throw=False).has_rig


def test_the_first_lens_that_folds_too_near_is_named():
    good = Intrinsics.of_lens(lens_of("left"), SIZE_PX)
    folds = Intrinsics(image_size_px=SIZE_PX, focal_length_px=350.0, distortion=(-0.27,))
    nothing = np.zeros((0, 2))
    assert assess_folds({"left": good}, {"left": nothing}) == (None, ())
    failure, notes = assess_folds(
        {"left": good, "right": folds}, {"left": nothing, "right": nothing}
    )
    assert str(failure).startswith('The fitted distortion of "right" folds the image 258 px')
    assert notes == ()


def test_a_lens_that_folds_beyond_everything_observed_is_noted_and_before_it_refused():
    folds = Intrinsics(image_size_px=SIZE_PX, focal_length_px=350.0, distortion=(-0.19,))
    observed = np.array([[319.5, 239.5], [319.5 + 300.0, 239.5]])
    failure, (note,) = assess_folds({"left": folds}, {"left": observed})
    assert failure is None
    assert note.startswith('The distortion of "left" folds the image 308 px from the principal')
    assert "show the board nearer to the image corners" in note
    beyond = np.concatenate([observed, [[319.5 + 309.0, 239.5]]])
    failure, notes = assess_folds({"left": folds}, {"left": beyond})
    assert str(failure).startswith('The fitted distortion of "left" folds the image 308 px')
    assert notes == ()


# A lens whose image circle ends before the corners, as estimated of a T265.
T265 = np.array([290.0, 290.0, 420.0, 388.0, 0.0144, 0.016, -0.019, 0.0])


def fisheye_shots(
    parameters: np.ndarray = T265, count: int = 30, sigma_px: float = 0.2
) -> list[Detection]:
    """Detections of corners up to 350 px from the middle of an image of 848 x 800 px."""
    lens = KannalaBrandt.from_parameters(parameters)
    random, detections = np.random.default_rng(0), []
    corners_mm = np.pad(BOARD.centres_mm, ((0, 0), (0, 1)))
    for azimuth in 6 * np.pi * np.arange(count) / count:
        off = np.radians(random.uniform(0, 58))
        about = off * np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        toward = Rotation.from_rotvec(about).as_matrix()
        tilt = Rotation.from_rotvec(random.uniform(-0.6, 0.6, 3)).as_matrix()
        rotation = toward @ tilt @ np.diag([1.0, -1.0, -1.0])
        pose = np.column_stack([rotation, random.uniform(150, 260) * toward[:, 2]])
        uv_px = np.asarray(made_shots._pixels(lens, np.eye(3, 4), pose, corners_mm))
        index = np.flatnonzero(np.linalg.norm(uv_px - [420, 388], axis=1) < 350)
        size = len(index)
        detections.append(
            Detection(
                circle_index=index,
                centres_px=uv_px[index] + random.normal(0, sigma_px, (size, 2)),
                covariance_px2=np.tile(sigma_px**2 * np.eye(2), (size, 1, 1)),
                shape_px2=np.full((size, 2, 2), np.nan),
                lines_px=np.full((2, 3), np.nan),
                image_size_px=(848, 800),
            )
        )
    return [each for each in detections if len(each) >= 8]


def test_a_coefficient_that_folds_the_image_is_fixed_where_the_residuals_allow_it():
    detections = fisheye_shots()
    folded = calibrate_intrinsics(
        detections, BOARD, lens_model="kannala_brandt", distortion=3, throw=False
    )
    assert folded.overall_status is Status.SUSPECT
    assert not folded.has_rig
    assert folded.notes[0].startswith('The fitted distortion of "camera" folds the image 3')
    result = calibrate_intrinsics(detections, BOARD, lens_model="kannala_brandt")
    assert result.has_rig
    assert describe_fold(result.lens) is None
    (note,) = [note for note in result.notes if "k3 was fixed at 0" in note]
    assert f"to {result.rms_px():.3f} px. Show" in note
    assert {"k3", "k4"}.isdisjoint(fitted_names(result))
    assert result.sigma("k3") == 0.0


# A fold in the corners of the image, 355 px from the principal point, with a strong k2.
IN_CORNERS = np.array([500.0, 500.0, 319.5, 239.5, -0.15, -0.14, 0.0, 0.0, 0.0])


def corner_shots(camera: str = "left") -> list[Detection]:
    """Detections of corners in the middle of the image, nearly without noise."""
    random = np.random.default_rng(0)
    poses = board_poses(10) * [1.0, 1.0, 1.0, 0.5]
    return [detection(camera, pose, random, sigma_px=0.01) for pose in poses]


def test_a_coefficient_that_the_residuals_ask_for_is_not_fixed(monkeypatch, tmp_path):
    """Without k2 the principal point moves by 24 px: the lens with its fold is the best one."""
    monkeypatch.setitem(made_shots.LENSES, "left", IN_CORNERS)
    detections = corner_shots()
    result = calibrate_intrinsics(detections, BOARD, lens_model="brown_conrady")
    assert result.overall_status is Status.CONVERGED
    assert result.has_rig
    assert result.sigma("k2") > 0.0
    (note,) = [note for note in result.notes if "folds the image" in note]
    assert note.startswith('The distortion of "camera" folds the image 35')
    np.testing.assert_allclose(result.lens.valid_radius_px, 355.0, atol=5.0)
    trinoc.save(result, tmp_path / "camera.json")
    assert trinoc.load(tmp_path / "camera.json") == result.lens


def test_a_rig_with_a_fold_in_the_corners_has_a_note_and_is_read_back(monkeypatch, tmp_path):
    monkeypatch.setitem(made_shots.LENSES, "left", IN_CORNERS)
    result = calibrate_rig({"left": corner_shots()}, BOARD, lens_model="brown_conrady")
    assert result.overall_status is Status.CONVERGED
    assert result.has_rig
    (note,) = [note for note in result.notes if "folds the image" in note]
    assert note in result.summary()
    trinoc.save(result, tmp_path / "rig.json")
    assert trinoc.load_rig(tmp_path / "rig.json") == result.rig


def test_a_lens_that_does_not_fold_keeps_its_coefficients():
    detections = shots(count=8, cameras=("left",))["left"]
    result = calibrate_intrinsics(detections, BOARD)
    assert not any("folds" in note for note in result.notes)


def test_a_strong_distortion_has_a_wider_model_unless_one_is_named():
    """The polynomial of Brown-Conrady folds between the board and the corners of the image.

    The board covers angles up to 45 degrees off the axis, and the corners lie at 73.
    """
    true = np.array([450.0, 450.0, 420.0, 388.0, 0.02, 0.005, 0.0, 0.0])
    detections = fisheye_shots(true, count=16, sigma_px=0.05)
    result = calibrate_rig({"left": detections}, BOARD)
    assert result.has_rig
    lens = result.rig["left"].intrinsics
    assert lens.distortion_model in ("rational", "kannala_brandt")
    assert describe_fold(lens) is None
    (note,) = [note for note in result.notes if "was used therefore" in note]
    assert note.startswith('The brown_conrady distortion of "left" folds the image')
    assert abs(result.value("left.fx_px") - 450.0) < 3 * result.sigma("left.fx_px")
    named = calibrate_rig({"left": detections}, BOARD, lens_model="brown_conrady")
    (note,) = [note for note in named.notes if "folds the image" in note]
    assert note.startswith('The distortion of "left" folds the image 404 px')
    assert named.has_rig
    assert 400 < named.rig["left"].intrinsics.valid_radius_px < 410
    alone = calibrate_intrinsics(detections, BOARD)
    assert alone.has_rig
    assert alone.lens.distortion_model == lens.distortion_model
    assert any("was used therefore" in note for note in alone.notes)


def holder(fit: RobustFit) -> ShotsFit:
    """Fit of a rig as `fit_wider_model` expects it."""
    return ShotsFit(cast(InitialRig, None), fit)


def fit_with_noise(sigma_px: float) -> ShotsFit:
    """Fit of the three cameras at the truth, with residuals of this standard deviation."""
    poses, random = board_poses(8), np.random.default_rng(0)
    here, names = problem(poses), tuple(made_shots.LENSES)
    # Eight shots do not determine k3.
    here = with_lens_free(here, np.tile(np.arange(9) < 8, (3, 1)))
    views = tuple(
        view._replace(
            detection=detection(names[view.camera], poses[view.shot], random, sigma_px=sigma_px)
        )
        for view in here.views
    )
    return holder(end_of_fit(here._replace(views=views), True, []))


@pytest.mark.parametrize(
    ("rational_px", "fisheye_px", "expected_model"),
    [(0.11, 0.05, Rational), (0.15, 0.11, KannalaBrandt), (0.15, 0.15, None)],
)
def test_a_wider_model_is_taken_where_it_explains_the_corners_as_well(
    monkeypatch, rational_px, fisheye_px, expected_model
):
    """The fit that folds has residuals of 0.1 px; up to a fifth more is no worse."""
    fits = {Rational: fit_with_noise(rational_px), KannalaBrandt: fit_with_noise(fisheye_px)}
    folds = np.array([350.0, 350.0, 319.5, 239.5, -0.27, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setitem(made_shots.LENSES, "left", folds)
    folding = fit_with_noise(0.1)
    result = fit_wider_model(folding, fits.__getitem__, tuple(made_shots.LENSES))
    assert result.fit is (folding if expected_model is None else fits[expected_model]).fit
    if expected_model is None:
        assert result.remarks == ()
    else:
        (sentence,) = result.remarks
        assert f"The lens model {expected_model.model} was used therefore" in sentence


def test_a_wider_model_that_the_shots_do_not_determine_is_not_taken(monkeypatch):
    """A model with too many coefficients always has small residuals."""
    determined = fit_with_noise(0.05)
    free = np.ones((3, 9), dtype=bool)
    undetermined = holder(
        determined.fit._replace(problem=with_lens_free(determined.fit.problem, free))
    )
    folds = np.array([350.0, 350.0, 319.5, 239.5, -0.27, 0.0, 0.0, 0.0, 0.0])
    monkeypatch.setitem(made_shots.LENSES, "left", folds)
    folding = fit_with_noise(0.1)
    fits = {Rational: undetermined, KannalaBrandt: determined}
    result = fit_wider_model(folding, fits.__getitem__, tuple(made_shots.LENSES))
    assert result.fit is determined.fit
