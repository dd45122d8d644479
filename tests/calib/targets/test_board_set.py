"""Boards of a set are distinguishable, are detected in one image, and are read from their file."""

import cv2
import numpy as np
import pytest

from trinoc.calib import BoardSet, detect_target
from trinoc.calib.detection.detection import split_by_board
from trinoc.calib.targets.abstract_target import AbstractTarget, Polygon
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import DetectionError, InputError
from trinoc.io import load_target
from trinoc.io.board_json import save_target

CHESS = Chessboard(rows=5, columns=6, square_mm=20.0)
TAGS = AprilGrid(rows=2, columns=3, tag_mm=30.0, first=12)
MARKED = Charuco(rows=5, columns=7, square_mm=20.0, marker_mm=15.0, first=40)
SHEET = Pattern.circle_grid(rows=4, columns=5, pitch_mm=20.0, radius_mm=5.0)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (CHESS, Chessboard(rows=6, columns=5, square_mm=10.0, name="other")),
        (TAGS, AprilGrid(rows=1, columns=2, tag_mm=9.0, first=17)),
        (
            MARKED,
            Charuco(rows=5, columns=7, square_mm=9.0, marker_mm=7.0, dictionary="4x4_50", first=30),
        ),
        (
            TAGS,
            Charuco(rows=5, columns=7, square_mm=9.0, marker_mm=7.0, dictionary="APRILTAG_36h11"),
        ),
        (SHEET, Pattern.default()),
    ],
)
def test_boards_that_look_alike_are_refused_whichever_comes_first(
    first: AbstractTarget, second: AbstractTarget
) -> None:
    for pair in ((first, second), (second, first)):
        with pytest.raises(
            InputError, match=r'^The boards ".*" and ".*" look alike in an image: .*\.$'
        ):
            BoardSet(dict(zip("ab", pair, strict=True)))


def test_boards_that_differ_are_a_set() -> None:
    boards = BoardSet({"a": CHESS, "b": TAGS, "c": MARKED, "d": SHEET})
    assert len(boards) == len(CHESS) + len(TAGS) + len(MARKED) + len(SHEET)
    np.testing.assert_array_equal(np.bincount(boards.board_of_point), [30, 24, 24, 20])
    BoardSet([TAGS, AprilGrid(rows=2, columns=3, tag_mm=30.0, first=18, name="next")])
    for wrong, message in (
        ([], "at least one"),
        ([boards], "is itself a set"),
        ([CHESS, CHESS], "Two boards have the name"),
    ):
        with pytest.raises(InputError, match=message):
            BoardSet(wrong)


def test_a_set_comes_back_from_its_file(tmp_path) -> None:
    boards = BoardSet({"a": CHESS, "b": TAGS, "c": MARKED, "d": SHEET}, name="cube")
    save_target(boards, tmp_path / "cube.json")
    back = load_target(tmp_path / "cube.json")
    assert isinstance(back, BoardSet)
    assert (back.names, back.name) == (boards.names, "cube")
    assert back.boards[:3] == boards.boards[:3]
    np.testing.assert_array_equal(back.centres_mm, boards.centres_mm)
    text = (tmp_path / "cube.json").read_text()
    (tmp_path / "cube.json").write_text(text.replace('"first": 12', '"first": 0', 1).replace(
        '"tag_mm"', '"tag"'))  # fmt: skip
    with pytest.raises(InputError, match=r"boards\.b\.aprilgrid"):
        load_target(tmp_path / "cube.json")


def test_the_first_marker_must_be_in_the_dictionary() -> None:
    with pytest.raises(InputError, match="has the markers 40 to 56, but 4x4_50 has 0 to 49"):
        Charuco(rows=5, columns=7, square_mm=9.0, marker_mm=7.0, dictionary="4x4_50", first=40)


def test_boards_are_found_beside_each_other_and_told_apart() -> None:
    picture = np.full((560, 1500), 230, np.uint8)
    boards = BoardSet({"chess": CHESS, "marked": MARKED, "tags": TAGS})
    scale, middles = 3.0, {"chess": (260, 280), "marked": (750, 280), "tags": (1240, 280)}
    shift = 16
    for name, board in zip(boards.names, boards.boards, strict=True):
        for polygon in board.drawing():
            assert isinstance(polygon, Polygon)
            corners = polygon.corners_mm * [scale, -scale] + middles[name]
            cv2.fillPoly(picture, [np.rint(corners * 2**shift).astype(np.int32)], 20,
                         cv2.LINE_AA, shift)  # fmt: skip
    detection = detect_target(cv2.GaussianBlur(picture, (0, 0), 0.8), boards)
    parts = split_by_board(detection, boards)
    assert sorted(parts) == [0, 1, 2]
    for number, name in enumerate(boards.names):
        part = parts[number]
        assert len(part) == len(boards.boards[number])
        expected = boards.centres_mm[part.circle_index] * [scale, -scale] + middles[name]
        np.testing.assert_allclose(part.centres_px, expected, atol=0.6)
    # A chessboard with an odd and an even number of corners looks itself turned by half.
    assert CHESS.turns.shape[0] == (
        1 if parts[0].ambiguity is None else 1 + len(parts[0].ambiguity)
    )
    with pytest.raises(DetectionError, match="None of the boards chess, marked, tags"):
        detect_target(np.full((240, 320), 128, np.uint8), boards)
