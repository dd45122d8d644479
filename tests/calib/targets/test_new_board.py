"""A new kind of board needs only a class and a detector for sets, files, drawings, the command."""

from typing import ClassVar

import cv2
import equinox as eqx
import numpy as np
import pytest

from trinoc.calib import BoardSet, detect_target
from trinoc.calib.detection.detection import build_detection
from trinoc.calib.detection.registry import DETECTORS
from trinoc.calib.targets.abstract_target import Marks
from trinoc.calib.targets.board_set import BOARDS
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.squares import AbstractSquareBoard, CellGrid, square_sheet
from trinoc.cli.main import main
from trinoc.errors import InputError
from trinoc.io import load_target
from trinoc.io.board_json import save_target
from trinoc.io.pattern_png import pattern_picture


class Steps(AbstractSquareBoard):
    """Board of inked squares that touch at one corner each, along a diagonal."""

    kind: ClassVar[str] = "steps"
    layout: ClassVar[dict[str, str]] = {"count": "rows", "square_mm": "square_mm"}

    rows: int = eqx.field(static=True)
    square_mm: float = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(self, *, rows, square_mm, name=None):
        self.rows, self.square_mm, self.name = rows, square_mm, name or "steps"

    @property
    def columns(self):
        return self.rows

    @property
    def centres_mm(self):
        return self.square_mm * (np.arange(1, self.rows)[:, None] - 0.5 * self.rows) * np.ones(2)

    @property
    def nodes_mm(self):
        return self.square_mm * (np.arange(self.rows + 1)[:, None] - 0.5 * self.rows) * np.ones(2)

    @property
    def marks(self):
        return Marks("steps", range(self.rows, self.rows + 1), "both climb; take another number")

    def cell_grids(self, *, quarters=0):
        return [CellGrid(np.eye(self.rows, dtype=bool)[::-1], self.square_mm, np.zeros(2))]


def detect_steps(image, board, tuning):
    """Detect the corners in an image that is square to the board, at one mm per pixel."""
    middle = 0.5 * np.array(image.shape[::-1]) - 0.5
    corners_px = board.centres_mm * [1.0, -1.0] + middle
    order = np.arange(len(board))[None]
    return build_detection(order, corners_px, np.tile(np.eye(2), (len(board), 1, 1)), image.shape)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(BOARDS, Steps.kind, Steps)
    monkeypatch.setitem(DETECTORS, Steps, detect_steps)


def test_it_is_drawn_saved_found_and_a_part_of_sets(tmp_path):
    board, chess = Steps(rows=5, square_mm=9.0), Chessboard(rows=3, columns=4, square_mm=9.0)
    picture = pattern_picture(board, size_px=(81, 81), pitch_mm=1.0)
    sheet = square_sheet(board)
    assert (picture < 128).sum() == 5 * 81
    assert sheet.ink.sum() == 5
    for target in (board, BoardSet({"a": board, "b": chess})):
        save_target(target, tmp_path / "board.json")
        assert load_target(tmp_path / "board.json") == target
    with pytest.raises(InputError, match="look alike in an image: both climb"):
        BoardSet({"a": board, "b": Steps(rows=5, square_mm=3.0)})
    BoardSet({"a": board, "b": Steps(rows=6, square_mm=3.0)})
    detection = detect_target(picture, board)
    corner = cv2.cornerSubPix(
        picture, detection.centres_px.astype(np.float32), (3, 3), (-1, -1), (3, 30, 1e-3)
    )
    np.testing.assert_allclose(corner, detection.centres_px, atol=0.1)


def test_the_command_draws_it(tmp_path):
    layout = tmp_path / "steps.json"
    assert main(["pattern", "steps", "--rows", "4", "-o", str(layout), "--quiet"]) == 0
    assert load_target(layout) == Steps(rows=4, square_mm=20.0)
    assert main(["pattern", "stairs", "-o", str(layout), "--quiet"]) == 2
