"""Layouts of boards come back from their files; shots are named as their pictures are."""

import json

import cv2
import numpy as np
import pytest

import trinoc
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io import load_shots, load_target
from trinoc.io.pattern_page import Polygon, lay_out, pattern_svg
from trinoc.io.saving import save

BOARDS = [
    Chessboard(rows=5, columns=8, square_mm=10.5, name="mine"),
    Charuco(rows=6, columns=8, square_mm=10.0, marker_mm=7.5, legacy=True),
    Charuco(rows=5, columns=4, square_mm=10.0, legacy=True, inverted=True, name="negative"),
    Charuco(rows=5, columns=4, square_mm=10.0, legacy=True, mirrored=True, name="back"),
    AprilGrid(rows=2, columns=3, tag_mm=20.0, spacing=0.25, border=1, first=5),
    Pattern.circle_grid(rows=3, columns=4, pitch_mm=10.0, radius_mm=2.0),
]


@pytest.mark.parametrize("board", BOARDS, ids=lambda board: board.name)
def test_a_board_comes_back(board, tmp_path):
    save(board, tmp_path / "board.json")
    loaded = load_target(tmp_path / "board.json")
    assert type(loaded) is type(board)
    assert loaded.name == board.name
    np.testing.assert_array_equal(loaded.centres_mm, board.centres_mm)
    if isinstance(board, Charuco):
        assert isinstance(loaded, Charuco)
        assert (loaded.dictionary, loaded.legacy) == (board.dictionary, True)
        assert loaded == board
    if isinstance(board, AprilGrid):
        assert isinstance(loaded, AprilGrid)
        assert (loaded.border, loaded.first) == (1, 5)


def test_a_layout_of_an_earlier_version_is_the_plain_print(tmp_path):
    board, path = BOARDS[1], tmp_path / "board.json"
    save(board, path)
    document = json.loads(path.read_text())
    for key in ("inverted", "mirrored"):
        assert document["charuco"].pop(key) == 0
    path.write_text(json.dumps(document))
    assert load_target(path) == board


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"inner_rows": 5', '"inner_rows": 5.5', "whole number"),
        ('"inner_rows": 5', '"inner_rows": 1', "too small"),
        ('"chessboard"', '"checkers"', "checkers"),
        ('"square_mm": 10.5', '"square_mm": "big"', "square_mm"),
    ],
)
def test_a_spoilt_layout_is_refused_with_its_file(old, new, message, tmp_path):
    save(BOARDS[0], tmp_path / "board.json")
    text = (tmp_path / "board.json").read_text()
    assert old in text
    (tmp_path / "board.json").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message) as caught:
        load_target(tmp_path / "board.json")
    assert "board.json" in str(caught.value)


def test_a_board_in_place_of_a_sheet_is_sent_to_the_command_that_takes_it(tmp_path):
    save(BOARDS[0], tmp_path / "board.json")
    with pytest.raises(InputError, match=r"not a sheet of circles.*calibrate-rig"):
        trinoc.load_pattern(tmp_path / "board.json")


def test_a_board_is_drawn_with_as_much_ink_as_it_has():
    board = BOARDS[0]
    page = lay_out(board, "a4")
    squares = [figure for figure in page.figures if isinstance(figure, Polygon)]
    area = sum(cv2.contourArea(f.corners_mm.astype(np.float32)) for f in squares)
    # 6 x 9 squares, half of them dark, and the scale bars.
    assert abs(area - 27 * 10.5**2) < 100.0
    assert pattern_svg(page).count("<polygon") == len(squares)
    with pytest.raises(InputError, match="more than a4 offers"):
        lay_out(Chessboard(rows=20, columns=30, square_mm=20.0), "a4")


def write_pictures(folder, *names):
    folder.mkdir(exist_ok=True)
    for name in names:
        cv2.imwrite(str(folder / name), np.full((20, 30), 7, np.uint8))


def test_pictures_of_equal_names_are_of_one_shot(tmp_path):
    write_pictures(tmp_path / "a", "one.png", "two.png")
    write_pictures(tmp_path / "b", "two.png", "three.png")
    shots = load_shots({"a": tmp_path / "a", "b": tmp_path / "b"})
    assert {name: list(camera_shots) for name, camera_shots in shots.items()} == {
        "a": ["one", "two"],
        "b": ["three", "two"],
    }
    assert shots["a"]["one"]().shape[:2] == (20, 30)


def test_what_all_names_of_a_camera_have_in_common_is_no_part_of_the_shot(tmp_path):
    write_pictures(tmp_path / "s", *(f"left_{k:02d}_raw.png" for k in (9, 10, 11)))
    write_pictures(tmp_path / "s", *(f"right{k:02d}.png" for k in (10, 11)))
    shots = load_shots({"l": f"{tmp_path}/s/left*.png", "r": f"{tmp_path}/s/right*.png"})
    assert list(shots["l"]) == ["09", "10", "11"]
    assert list(shots["r"]) == ["10", "11"]


def test_places_without_pictures_and_pictures_of_two_cameras_are_refused(tmp_path):
    write_pictures(tmp_path / "a", "one.png")
    with pytest.raises(InputError, match='the folder of "b", does not exist'):
        load_shots({"a": tmp_path / "a", "b": tmp_path / "none"})
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match='no picture of "b"'):
        load_shots({"a": tmp_path / "a", "b": tmp_path / "empty"})
    with pytest.raises(InputError, match='of "a" and of "b"'):
        load_shots({"a": tmp_path / "a", "b": f"{tmp_path}/a/*.png"})
