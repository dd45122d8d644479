"""A tuning passed to a call holds for that call only, and in every part of a detection."""

import numpy as np
import pytest

from tests.calib.detection.test_boards import BOARDS, picture
from trinoc.calib import detect_pattern, detect_target
from trinoc.calib.starts.pictures import find_boards
from trinoc.calib.starts.placing import boards_are_parallel
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import DetectionError
from trinoc.geometry import Pose
from trinoc.io import demo_images, demo_pattern
from trinoc.numerics.tables import with_field


def arrays(detection):
    names = ("circle_index", "centres_px", "covariance_px2", "shape_px2", "lines_px")
    return [getattr(detection, name).tobytes() for name in names]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("roundness", (1.2, 1.3)),
        ("area_factor", 1.0),
        ("fewest_places", 1000),
        ("margin", 1e6),
        ("largest_area_ratio", 1.0),
    ],
)
def test_a_gate_that_no_circle_passes_refuses_the_sheet_in_this_call_alone(name, value) -> None:
    image, pattern = demo_images("sheet")["left"], demo_pattern()
    before = arrays(detect_pattern(image, pattern))
    closed = with_field(TUNING, f"detection.{name}", value)
    with pytest.raises(DetectionError):
        detect_pattern(image, pattern, tuning=closed)
    assert arrays(detect_pattern(image, pattern, tuning=CalibTuning())) == before
    assert arrays(detect_pattern(image, pattern)) == before


@pytest.mark.parametrize("name", ["chessboard", "charuco", "aprilgrid"])
def test_the_floor_of_corners_is_added_to_their_covariances_and_to_nothing_else(name) -> None:
    board = BOARDS[name]
    image, _ = picture(board)
    usual = detect_target(image, board)
    bare = detect_target(image, board, tuning=with_field(TUNING, "detection.corner_floor_px", 0.0))
    np.testing.assert_array_equal(bare.centres_px, usual.centres_px)
    floor_px2 = TUNING.detection.corner_floor_px**2 * np.eye(2)
    np.testing.assert_allclose(
        usual.covariance_px2 - bare.covariance_px2,
        np.broadcast_to(floor_px2, usual.covariance_px2.shape),
        atol=1e-12,
    )


def test_the_images_of_a_recording_are_searched_with_the_tuning_that_is_passed() -> None:
    board = BOARDS["chessboard"]
    image, _ = picture(board)
    tuning = with_field(TUNING, "detection.corner_floor_px", 1.0)
    boards = find_boards({"left": {"1": image}}, board, tuning=tuning)
    assert arrays(boards.detections["left"]["1"]) == arrays(
        detect_target(image, board, tuning=tuning)
    )
    assert arrays(boards.detections["left"]["1"]) != arrays(detect_target(image, board))


def test_planes_are_parallel_within_the_angle_of_the_tuning() -> None:
    angle = np.radians(5.0)
    turn = np.array(
        [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    )
    poses = [Pose(np.eye(3, 4)), Pose(np.column_stack([turn, np.zeros(3)]))]
    assert boards_are_parallel(poses)
    assert not boards_are_parallel(poses, tuning=with_field(TUNING, "starts.parallel_deg", 4.0))
