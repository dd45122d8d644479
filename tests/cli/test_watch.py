"""`trinoc watch`: pictures judged as they arrive, and how it ends."""

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.serving.asking import ask
from trinoc.calib import BoardSet
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.squares import dark_squares
from trinoc.cli.main import main
from trinoc.io.board_json import save_target
from trinoc.serving.sources import PATIENCE, FolderArrivals

BOARD = Chessboard(rows=5, columns=7, square_mm=20.0)


def board_picture(shift_px: tuple[int, int] = (0, 0)) -> np.ndarray:
    """An image of the board facing the camera, with squares of 40 px."""
    picture = np.full((480, 640), 210, dtype=np.uint8)
    squares = np.kron(dark_squares(BOARD.rows + 1, BOARD.columns + 1), np.ones((40, 40)))
    left_px, upper_px = 160 + shift_px[0], 120 + shift_px[1]
    window = picture[upper_px : upper_px + squares.shape[0], left_px : left_px + squares.shape[1]]
    window[squares > 0] = 30
    return cv2.GaussianBlur(picture, (0, 0), 1.0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_target(BOARD, tmp_path / "board.json")
    (tmp_path / "in").mkdir()
    return tmp_path


def watch(folder: Path, *options: str) -> tuple[str, ...]:
    return "watch", str(folder / "in"), "--pattern", str(folder / "board.json"), *options


def test_a_set_of_boards_is_not_watched(folder, capsys) -> None:
    save_target(BoardSet([BOARD]), folder / "board.json")
    assert main(watch(folder, "--once", "--quiet")) == 2
    assert "contains several boards" in capsys.readouterr().err


def test_pictures_that_are_there_are_judged_once(folder, capsys) -> None:
    cv2.imwrite(str(folder / "in" / "a.png"), board_picture())
    cv2.imwrite(str(folder / "in" / "b.png"), np.full((480, 640), 255, np.uint8))
    (folder / "in" / "c.png").write_bytes(b"no picture")
    (folder / "in" / "notes.txt").write_text("not looked at")
    assert main(watch(folder, "--once", "--json", "--quiet")) == 0
    out, err = capsys.readouterr()
    assert err == ""
    records = {each["name"]: each for each in json.loads(out)["pictures"]}
    assert set(records) == {"a.png", "b.png", "c.png"}
    assert records["a.png"]["good"]
    assert records["a.png"]["found"] == records["a.png"]["of"] == len(BOARD)
    assert not records["b.png"]["good"]
    assert any("saturated" in fault for fault in records["b.png"]["faults"])
    assert "not a readable picture" in records["c.png"]["refusal"]


def test_a_picture_is_told_once_it_is_whole_and_again_when_it_is_replaced(folder) -> None:
    arrivals = FolderArrivals(folder / "in")
    path = folder / "in" / "slow.png"
    content = cv2.imencode(".png", board_picture())[1].tobytes()
    path.write_bytes(content[: len(content) // 2])
    # It does not change, but has no end.
    assert [arrivals.ready() for _ in range(3)] == [[], [], []]
    path.write_bytes(content)
    assert arrivals.ready() == []
    assert arrivals.ready() == [path]
    assert arrivals.ready() == []
    path.write_bytes(content + b"\0")
    assert [arrivals.ready(), arrivals.ready()] == [[], [path]]
    # What never gets its end is told in the end, as broken.
    path.write_bytes(content[:-20])
    assert [path] in [arrivals.ready() for _ in range(PATIENCE + 1)]


def test_ctrl_c_ends_with_the_summary_and_the_page_was_there(folder, capsys, monkeypatch) -> None:
    cv2.imwrite(str(folder / "in" / "a.png"), board_picture())
    answers: list[tuple[int, str]] = []

    def sleep(_: float) -> None:
        output = capsys.readouterr()
        if "http" in output.err:
            sleep.url = re.search(r"http://\S+", output.err)[0]  # pyright: ignore
        if "a.png" in output.out:
            answers.extend([ask(sleep.url), ask(sleep.url, "/0.jpg"), ask(sleep.url, "/a.png")])  # pyright: ignore
            raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", sleep)
    assert main(watch(folder)) == 0
    assert [status for status, _ in answers] == [200, 200, 404]
    assert "a.png" in answers[0][1]
    out = capsys.readouterr().out
    assert "1 pictures: 1 good" in out
    assert "Move the board" in out


class _Camera:
    """A camera that sends three pictures, of which the second equals the first, and then stops."""

    pictures = (board_picture(), board_picture(), board_picture((60, 40)))

    def __init__(self, number: int) -> None:
        self.number, self.count = number, -1

    def isOpened(self) -> bool:
        return self.number == 0

    def grab(self) -> bool:
        self.count += 1
        return self.count < len(self.pictures)

    def retrieve(self) -> tuple[bool, Any]:
        return True, self.pictures[self.count]

    def release(self) -> None:
        self.number = -1


def test_of_a_camera_pictures_that_show_something_new_are_kept(folder, capsys, monkeypatch) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", _Camera)
    keep = folder / "kept"
    board = str(folder / "board.json")
    options = ("--keep", str(keep), "--every-s", "1e-9", "--port", "none")
    assert main(("watch", "0", "--pattern", board, *options)) == 1
    out, err = capsys.readouterr()
    assert "stopped sending pictures" in err
    assert "picture 3: good" in out
    saved = sorted(keep.iterdir())
    assert [path.name for path in saved] == ["shot_0001.png", "shot_0002.png"]
    np.testing.assert_array_equal(cv2.imread(str(saved[0]), 0), _Camera.pictures[0])
    assert main(("watch", "3", "--pattern", board)) == 1
    assert "Camera 3 does not open" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("watch", "in", "--every-s", "0"), "--every-s is 0"),
        (("watch", "in", "--keep", "k"), "--keep is an option for cameras"),
        (("watch", "in", "--port", "65536"), "--port is 65536"),
        (("watch", "in", "--port", "-1"), "--port is -1"),
        (("watch", "0", "--once"), "--once is an option for folders"),
    ],
)
def test_options_that_do_not_go_together_are_named(options, message, capsys) -> None:
    pattern = ("--pattern", "none.json") if options[0] == "watch" else ()
    assert main((*options, *pattern)) == 2
    assert message in capsys.readouterr().err


def test_a_folder_that_is_none_is_named(folder, capsys) -> None:
    command = ("watch", str(folder / "no"), "--pattern", str(folder / "board.json"))
    for options in ((), ("--once",)):
        assert main((*command, *options)) == 1
        stderr = capsys.readouterr().err
        assert "is not a folder" in stderr
        assert "http" not in stderr
