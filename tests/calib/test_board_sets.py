"""Boards fixed to each other are estimated with the rig, with any board as the reference."""

import numpy as np
import pytest

from tests.calib.made_board_sets import (
    BOARDS,
    CAMERAS,
    IN_SET,
    LENS_OF,
    SIGMA_PX,
    detect_boards,
    fixed,
    poses_of_set,
    set_of,
    set_shots,
)
from tests.calib.made_shots import (
    BOARD,
    SIZE_PX,
    board_poses,
    chained,
    inverse,
    lens_of,
    shots,
)
from tests.calib.problem.equations import assert_equations_are_those_of_the_cost
from trinoc.calib import BoardSet, Detection, next_shot
from trinoc.calib.advice.halves import find_steps_to_half
from trinoc.calib.detection.detection import split_by_board
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import FreeLensParameters, Problem
from trinoc.calib.problem.robust_fit import fit_points
from trinoc.calib.problem.starting_problem import start_problem
from trinoc.calib.problem.views import BoardObservation
from trinoc.calib.result.summary import fixed_boards
from trinoc.calib.rig_calibration import calibrate_rig
from trinoc.calib.starts.connected import solve_hand_eye
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import Pose
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rotation import rotation_from_vector

EXACT = Systematics()
OPPOSITE = ("left", "far"), ("front", "back")
KNOWN = {name: Intrinsics.of_lens(lens_of(lens), SIZE_PX) for name, lens in LENS_OF.items()}


def far_from_left(rig) -> np.ndarray:
    return chained(
        np.asarray(rig["far"].cam_from_world), inverse(np.asarray(rig["left"].cam_from_world))
    )


def known_problem(random: np.random.Generator, systematics: Systematics = EXACT) -> Problem:
    """Problem at the truth: cameras that face each other, one board for each, and known lenses."""
    cameras, boards = OPPOSITE
    target, poses, views = set_of(boards), poses_of_set(6), []
    for number, camera in enumerate(cameras):
        for shot, pose in enumerate(poses):
            detection = detect_boards(camera, pose, boards, random)
            if detection is None:
                continue
            for board, board_detection in split_by_board(detection, target).items():
                views.append(
                    BoardObservation(
                        number,
                        shot,
                        board_detection,
                        np.ones(len(board_detection), bool),
                        board=board,
                    )
                )
    return start_problem(
        views,
        target,
        [lens_of(LENS_OF[camera]) for camera in cameras],
        np.stack([CAMERAS[camera] for camera in cameras]),
        poses,
        [SIZE_PX] * 2,
        FreeLensParameters(np.arange(2), np.zeros((2, 9), dtype=bool)),
        systematics,
        np.stack([IN_SET[board] for board in boards]),
    )


@pytest.fixture(scope="module")
def calibration():
    """Calibration of cameras that face each other and never see the same board."""
    cameras, boards = OPPOSITE
    shots = set_shots(boards, cameras, count=8)
    return calibrate_rig(
        shots, set_of(boards), lens=KNOWN_OPPOSITE, systematics=EXACT, world="left"
    )


KNOWN_OPPOSITE = {name: KNOWN[name] for name in OPPOSITE[0]}


def test_cameras_that_never_see_one_board_are_connected_by_their_motions(calibration):
    assert calibration.has_rig
    true = chained(CAMERAS["far"], inverse(CAMERAS["left"]))
    np.testing.assert_allclose(far_from_left(calibration.rig), true, atol=0.3)
    np.testing.assert_allclose(
        calibration.reference_from_board[1], fixed("front", "back"), atol=0.2
    )
    for k, axis in enumerate("xyz"):
        name = f"board.back.{axis}_mm"
        assert abs(calibration.value(name) - fixed("front", "back")[k, 3]) < 4 * calibration.sigma(
            name
        )
        assert 0 < calibration.sigma(name) < 0.2
        assert 0 < calibration.sigma(f"board.back.turn_{axis}_deg") < 0.1
    assert 0.8 < calibration.reduced_chi_square < 1.2
    (sentence,) = fixed_boards(calibration)
    assert sentence.startswith('"back" lies at x ')
    assert sentence in calibration.summary()
    assert 0.4 < calibration.halves.ratio < 1.8


def test_which_board_is_the_reference_changes_the_frame_alone(calibration):
    cameras, boards = OPPOSITE
    turned = boards[::-1]
    pictures = {}
    for camera, detections in set_shots(boards, cameras, count=8).items():
        # The same noise: the labels alone change.
        counts = [len(BOARDS[name]) for name in boards]
        order = np.concatenate([np.arange(counts[0]) + counts[1], np.arange(counts[1])])
        pictures[camera] = [
            Detection(**{**vars(each), "circle_index": order[each.circle_index]})
            for each in detections
            if each is not None
        ]
    other = calibrate_rig(
        pictures, set_of(turned), lens=KNOWN_OPPOSITE, systematics=EXACT, world="left"
    )
    assert other.has_rig
    np.testing.assert_allclose(far_from_left(other.rig), far_from_left(calibration.rig), atol=1e-5)
    np.testing.assert_allclose(
        other.reference_from_board[1], inverse(calibration.reference_from_board[1]), atol=1e-5
    )
    for name in calibration.rig.parameters:
        assert other.rig.sigma(name) == pytest.approx(calibration.rig.sigma(name), rel=1e-4)
    # The set lies where its first board does.
    np.testing.assert_allclose(
        chained(calibration.world_from_board[0], calibration.reference_from_board[1]),
        other.world_from_board[0],
        atol=1e-5,
    )


@pytest.mark.slow
def test_one_board_in_a_set_is_that_board():
    alone, one = (
        calibrate_rig(shots(), board, systematics=EXACT) for board in (BOARD, BoardSet([BOARD]))
    )
    np.testing.assert_array_equal(one.values, alone.values)
    np.testing.assert_array_equal(one.covariance, alone.covariance)


def test_the_equations_of_a_set_are_those_of_the_cost():
    here = known_problem(np.random.default_rng(0), Systematics.typical({}))
    assert_equations_are_those_of_the_cost(here)


def test_errors_are_as_large_as_is_claimed():
    squares, truth = [], known_problem(np.random.default_rng(0))
    for seed in range(30):
        start = known_problem(np.random.default_rng(100 + seed))._replace(state=truth.state)
        end, converged = fit_points(start)
        assert converged
        information = compute_information(end)
        covariance = information.observability.covariance
        step = find_steps_to_half(truth, end)[information.free]
        squares.append(step @ np.linalg.solve(covariance, step) / len(step))
    # The mean of 360 squares.
    assert 0.9 < np.sqrt(np.mean(squares)) < 1.1


def test_motions_that_turn_about_one_axis_leave_something_open():
    cameras, boards = board_poses(1, seed=8)[0], board_poses(1, seed=9)[0]
    first = board_poses(5)
    second = [Pose(chained(chained(cameras, pose), boards)) for pose in first]
    first = [Pose(pose) for pose in first]
    solution = solve_hand_eye(first, second, TUNING)
    assert solution is not None
    np.testing.assert_allclose(solution.cameras.cam_from_world, cameras, atol=1e-8)
    np.testing.assert_allclose(solution.boards.cam_from_world, boards, atol=1e-8)
    angles = 0.2 * np.arange(5)
    turns = [np.asarray(rotation_from_vector(np.array([0.0, 0.0, angle]))) for angle in angles]
    on_a_table = [
        Pose(np.column_stack([turn, [9 * angle, 5.0, 600.0]]))
        for turn, angle in zip(turns, angles, strict=True)
    ]
    assert solve_hand_eye(on_a_table, on_a_table, TUNING) is None
    assert solve_hand_eye(first[:2], second[:2], TUNING) is None


def test_boards_that_nothing_connects_are_named():
    pictures = set_shots(("front", "side"), ("left",), count=6)
    one_at_a_time = []
    for number, each in enumerate(pictures["left"]):
        assert each is not None
        parts = split_by_board(each, set_of(("front", "side")))
        one_at_a_time.append(parts.get(number % 2, parts[0]))
    with pytest.raises(CalibrationError, match="connects the boards: the groups are front; side"):
        calibrate_rig({"left": one_at_a_time}, set_of(("front", "side")), lens=KNOWN["left"])
    with pytest.raises(CalibrationError, match='"other" was found in no image'):
        calibrate_rig(
            pictures,
            BoardSet({**{n: BOARDS[n] for n in ("front", "side")},
                      "other": Chessboard(rows=8, columns=9, square_mm=10.0)}),
            lens=KNOWN["left"],
        )  # fmt: skip


def test_a_set_is_fitted_by_its_points_alone():
    picture = np.full((480, 640), 128, np.uint8)
    with pytest.raises(InputError, match="contains several boards"):
        calibrate_rig({"left": [picture]}, set_of(("front", "side")), method="pixels")


@pytest.mark.slow
def test_a_camera_sees_several_boards_in_a_shot():
    names = ("front", "side")
    lenses = {name: KNOWN[name] for name in ("left", "right")}
    result = calibrate_rig(set_shots(names, ("left", "right"), count=8), set_of(names), lens=lenses)
    assert result.has_rig
    np.testing.assert_allclose(result.reference_from_board[1], fixed(*names), atol=0.5)
    assert {view.board for view in result.views} == {0, 1}
    assert {"board.front.scale_x", "board.side.warp_x_mm"} <= set(result.parameters)
    assert result.sigma("board.side.x_mm") > 0
    assert SIGMA_PX * 1.2 < result.rms_px() < SIGMA_PX * 1.6
    advice = next_shot(result)
    assert advice is not None
    assert '"side"' in advice.sentence or '"front"' in advice.sentence
