"""`trinoc pattern --board` and `trinoc calibrate-rig`: files, and what they say of mistakes."""

import json

import cv2
import numpy as np
import pytest

from tests.capture.made_boards import CHESSBOARD, board_picture, hold_board
from tests.report.test_shots import made_up
from trinoc.calib import Status
from trinoc.cli.main import main
from trinoc.io import load_target
from trinoc.io.rig_json import load_rig_status
from trinoc.io.saving import save


@pytest.mark.parametrize(
    ("board", "corners"),
    [
        (("chessboard", "square_mm=20"), 24),
        (("charuco", "square_mm=20", "marker_mm=14", "dictionary=5x5_250"), 24),
        (("aprilgrid", "tag_mm=20", "first=3"), 140),
    ],
)
def test_a_board_is_drawn_with_its_layout(board, corners, tmp_path, capsys):
    layout = tmp_path / "board.json"
    size = ["--rows", "5", "--columns", "7"]
    assert main(["pattern", *board, *size, "-o", str(layout), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["corners"] == corners
    assert len(load_target(layout)) == corners
    assert "<polygon" in layout.with_suffix(".svg").read_text()
    second_layout = tmp_path / "again.json"
    assert main(["pattern", str(layout), "--paper", "a3", "-o", str(second_layout)]) == 0
    assert second_layout.read_text() == layout.read_text()


@pytest.mark.parametrize(
    ("folders", "message", "status"),
    [
        ([], "No pictures are given", 2),
        (["left"], "names no camera", 2),
        (["left=nowhere"], 'the folder of "left", does not exist', 1),
        (["left=pictures", "right=pictures"], 'of "left" and of "right"', 1),
        (["left=pictures"], 'found in no image of camera "left"', 1),
    ],
)
def test_mistakes_are_told_in_one_sentence(folders, message, status, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite("pictures/1.png", np.full((60, 80), 100, np.uint8))
    assert main(["pattern", "charuco", "-o", "board.json", "--quiet"]) == 0
    capsys.readouterr()
    assert main(["calibrate-rig", *folders, "--board", "board.json", "--quiet"]) == status
    assert message in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


@pytest.mark.parametrize("command", [["calibrate-rig", "left=pictures"], ["intrinsics", "a.png"]])
def test_a_board_that_is_not_given_is_asked_for(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 2
    assert "add --board FILE" in capsys.readouterr().err


def test_a_rig_whose_lens_is_refuted_is_written_and_counts_as_failed(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite("pictures/1.png", np.full((60, 80), 100, np.uint8))
    assert main(["pattern", "charuco", "-o", "board.json", "--quiet"]) == 0
    refuted = made_up(status=Status.SUSPECT, notes=("Another lens.",))
    monkeypatch.setattr("trinoc.calibrate_rig", lambda *_, **__: refuted)
    monkeypatch.setattr("trinoc.next_shot", lambda _: None)
    assert main(["calibrate-rig", "left=pictures", "--board", "board.json", "--quiet"]) == 1
    assert "SUSPECT, which is stated in rig.json: Another lens." in capsys.readouterr().err
    cameras = load_rig_status("rig.json").cameras
    assert {each.status for each in cameras.values()} == {"suspect"}


def test_boards_that_look_alike_are_told_apart_by_their_first_marker(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    cv2.imwrite("pictures/1.png", np.full((60, 80), 100, np.uint8))
    size = ["--rows", "4", "--columns", "5", "--quiet"]
    for name, first in (("front", "0"), ("back", "19"), ("side", "20")):
        assert main(["pattern", "aprilgrid", f"first={first}", *size, "-o", f"{name}.json"]) == 0
    capsys.readouterr()
    command = ["calibrate-rig", "left=pictures", "--quiet", "--board", "front.json", "--board"]
    assert main([*command, "back.json"]) == 1
    stderr = capsys.readouterr().err
    assert (
        'The boards "front" and "back" look alike in an image: both have the marker 19 of' in stderr
    )
    assert main([*command, "side.json"]) == 1
    assert "None of the boards front, side was found" in capsys.readouterr().err


def test_a_set_from_pixels_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for board in ("charuco", "chessboard"):
        assert main(["pattern", board, "-o", f"{board}.json", "--quiet"]) == 0
    (tmp_path / "pictures").mkdir()
    cv2.imwrite("pictures/1.png", np.full((60, 80), 100, np.uint8))
    options = ["--method", "pixels", "--board", "charuco.json", "--board", "chessboard.json"]
    assert main(["calibrate-rig", "left=pictures", *options]) == 1
    assert 'use method="points".' in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


TURNS = [(35, 0, 5), (-35, 5, -8), (0, 35, 12), (3, -35, 0), (25, 25, -5), (-25, 25, 8)]


def test_a_rig_of_two_cameras_states_their_baseline_and_draws_residuals_on_its_images(
    tmp_path, monkeypatch, capsys
):
    """The cameras stand 150 mm apart, turned by .17 rad about y. One image shows no board."""
    monkeypatch.chdir(tmp_path)
    save(CHESSBOARD, "board.json")
    for camera in ("left", "right"):
        (tmp_path / camera).mkdir()
        for k, turn in enumerate(TURNS):
            pose = hold_board((75 + 12 * (k % 3 - 1), 8 * (k % 2), 430.0), turn, CHESSBOARD)
            image = board_picture(camera, [pose], seed=k, board=CHESSBOARD)
            cv2.imwrite(f"{camera}/{k}.png", image)
    cv2.imwrite("left/7.png", np.full_like(image, 120))
    options = ["--board", "board.json", "--distortion", "0", "--report", "r.html", "--quiet"]
    assert main(["calibrate-rig", "left=left", "right=right", *options, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    (pair,) = record["pairs"]
    assert pair["cameras"] == ["left", "right"]
    baseline, angle = pair["baseline_mm"], pair["angle_deg"]
    assert abs(baseline["value"] - 150.0) < 5 * baseline["sigma"]
    # The size of the print, and the mean of its stretches along X and Y.
    assert baseline["sigma_board_size"] == pytest.approx(0.002 * np.sqrt(1.5) * 150.0, rel=0.2)
    expected = np.hypot(baseline["sigma_board_size"], baseline["sigma_rest"])
    assert expected == pytest.approx(baseline["sigma"], rel=1e-6)
    assert abs(angle["value"] - np.degrees(0.17)) < 5 * angle["sigma"]
    assert abs(pair["turn_deg"]["y"]["value"]) == pytest.approx(angle["value"], rel=0.05)
    assert record["pixel_sigma"]["median_px"] < record["pixel_sigma"]["worst_px"]
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert page.count("data:image/jpeg") == 2 * len(TURNS)
    assert "Residuals of each shot on its image" in page
    assert "left, 7" in page
