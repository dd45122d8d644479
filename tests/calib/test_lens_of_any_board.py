"""`calibrate_intrinsics` accepts every board and has the same lens as `calibrate_rig`."""

import numpy as np
import pytest

from tests.calib.made_board_sets import BOARDS, LENS_OF, detect_boards, poses_of_set
from tests.calib.made_shots import (
    BOARD,
    LENSES,
    board_poses,
    detection,
    lens_of,
    shots,
)
from tests.calib.simulated_lens import fitted_names, lens_sigmas, lens_values, squared_distance
from trinoc.calib import BoardSet, Status, next_shot
from trinoc.calib.from_points import calibrate_points
from trinoc.calib.lens_calibration import calibrate_intrinsics
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.saving import load, save

ANY_BOARD = {
    "chessboard": BOARD,
    "charuco": Charuco(rows=6, columns=7, square_mm=24.0, marker_mm=18.0),
    "aprilgrid": AprilGrid(rows=3, columns=4, tag_mm=30.0),
}


def detections_by_left(board, count: int = 12, seed: int = 4) -> list:
    random = np.random.default_rng(seed)
    return [detection("left", pose, random, board) for pose in board_poses(count, seed=seed)]


@pytest.mark.parametrize("name", ANY_BOARD)
def test_the_lens_of_any_board_is_the_true_one(name):
    result = calibrate_intrinsics(
        detections_by_left(ANY_BOARD[name]), ANY_BOARD[name], distortion=4
    )
    assert result.overall_status is Status.CONVERGED
    # A chi-square of eight: its quantile of 1 - 1e-5.
    assert squared_distance(result, LENSES["left"]) < 37.0
    assert "corners in 12 images" in result.summary()
    assert "flatness of the sheet" in result.summary()


@pytest.mark.parametrize("systematics", [None, Systematics()])
def test_it_is_the_lens_that_a_rig_of_one_camera_has(systematics):
    detections = shots(count=8, cameras=("left",))
    alone = calibrate_intrinsics(detections["left"], BOARD, distortion=4, systematics=systematics)
    rig = calibrate_rig(detections, BOARD, distortion=4, systematics=systematics)
    sigma = lens_sigmas(alone)
    assert rig.lens_parameters == alone.lens_parameters
    assert np.all(np.abs(lens_values(rig) - lens_values(alone)) <= 1e-3 * sigma)
    np.testing.assert_allclose(lens_sigmas(rig), sigma, rtol=1e-3)


def test_boards_fixed_to_each_other_serve_one_lens():
    random = np.random.default_rng(2)
    boards = ("front", "side")
    target = BoardSet({name: BOARDS[name] for name in boards})
    detections_or_none = [detect_boards("left", pose, boards, random) for pose in poses_of_set(12)]
    detections = [each for each in detections_or_none if each is not None]
    result = calibrate_intrinsics(detections, target, distortion=4)
    assert result.has_rig
    # Most pictures show both boards, each with a pose of its own.
    assert {view.shot for view in result.views} == set(range(len(detections)))
    assert len(result.views) > len(detections)
    truth = np.asarray(lens_of(LENS_OF["left"]).parameters)
    assert squared_distance(result, truth) < 37.0


def test_what_is_held_is_held_with_any_board():
    detections = detections_by_left(BOARD)
    result = calibrate_intrinsics(
        detections, BOARD, distortion=2, principal_point="centre", aspect="pitch", throw=False
    )
    assert fitted_names(result) == ("fx_px", "fy_px", "k1", "k2")
    np.testing.assert_array_equal(lens_values(result)[2:4], [319.5, 239.5])
    assert result.value("fx_px") == pytest.approx(result.value("fy_px"), rel=1e-12)


def test_splines_correct_the_lens_of_any_board_and_the_next_picture_is_advised():
    result = calibrate_intrinsics(
        detections_by_left(BOARD), BOARD, lens_model="splined", throw=False
    )
    plain = calibrate_intrinsics(detections_by_left(BOARD), BOARD, throw=False)
    advice, plain_advice = next_shot(result), next_shot(plain)
    assert advice is not None
    assert plain_advice is not None
    assert advice.instruction == plain_advice.instruction


def test_a_lens_is_saved_as_a_lens_and_one_camera_as_a_rig(tmp_path):
    detections = shots(count=8, cameras=("left",))
    lens = calibrate_intrinsics(detections["left"], BOARD, distortion=4)
    save(lens, tmp_path / "camera.json")
    assert isinstance(load(tmp_path / "camera.json"), Intrinsics)
    # Also where the frame of the camera is the world's.
    rig = calibrate_rig(detections, BOARD, distortion=4, world="left")
    save(rig, tmp_path / "rig.json")
    back = load(tmp_path / "rig.json")
    assert isinstance(back, Rig)
    np.testing.assert_allclose(back.covariance, rig.rig.covariance, rtol=1e-12)


def test_a_camera_from_points_is_saved_as_a_rig(tmp_path):
    random, camera = (
        np.random.default_rng(1),
        Camera(
            Intrinsics(focal_length_px=900.0, image_size_px=(640, 480)),
            Pose(np.column_stack([np.diag([1.0, -1.0, -1.0]), [0.0, 0.0, 500.0]])),
        ),
    )
    points = random.uniform(-60, 60, (60, 3))
    exact = np.stack([camera.project(point) for point in points])
    uv_px = exact + random.normal(0, 0.05, exact.shape)
    result = calibrate_points(points, uv_px, image_size_px=(640, 480))
    save(result, tmp_path / "rig.json")
    back = load(tmp_path / "rig.json")
    assert back.parameters == result.parameters
    np.testing.assert_allclose(back.covariance, result.covariance, rtol=1e-12)
