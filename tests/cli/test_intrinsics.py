"""`trinoc intrinsics` on rendered pictures, and what it says of bad ones."""

import json

import cv2
import numpy as np
import pytest

import trinoc
from simulation.camera_picture.render import render_sheet
from tests.capture.made_boards import (
    FOCAL_PX,
    SIZE_PX as BOARD_SIZE_PX,
    board_picture,
    hold_board,
)
from trinoc.cli.main import main
from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.io import load_intrinsics
from trinoc.io.intrinsics_json import load_lens_covariance

SHEET = trinoc.Pattern.cross_grid(rows=6, columns=6, pitch_mm=25.0, radius_mm=8.0)
LENS = Intrinsics(image_size_px=(320, 300), focal_length_px=(610.0, 745.0), distortion=(-0.2, 0.1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lens")
    for k, (pan, tilt) in enumerate([(0, 50), (90, 55), (180, 50), (-90, 60), (40, 80)]):
        camera = Camera.from_degrees(
            LENS, pan_deg=pan, tilt_deg=tilt, swing_deg=10 * k, distance_mm=470
        )
        image = render_sheet(SHEET, camera, noise_sigma=2.0, seed=k, supersampling=4)
        cv2.imwrite(str(folder / f"{k}.png"), image)
    cv2.imwrite(str(folder / "blank.png"), np.full((300, 320), 200, np.uint8))
    trinoc.save(SHEET, folder / "sheet.json")
    return folder


def pictures(folder):
    return [str(folder / f"{k}.png") for k in range(5)]


def test_pictures_become_a_lens_with_covariance(folder, capsys):
    out = folder / "camera.json"
    sheet = ["--pattern", str(folder / "sheet.json"), "-o", str(out), "--distortion", "2"]
    assert main(["intrinsics", *pictures(folder), *sheet, "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["pictures"] == 5
    assert record["written"] == [str(out)]
    for name, true in (("fx_px", 610.0), ("fy_px", 745.0), ("cx_px", 159.5), ("k1", -0.2)):
        estimate = record["parameters"][name]
        assert abs(estimate["value"] - true) < 5 * estimate["sigma"]
    lens, covariance = load_intrinsics(out), load_lens_covariance(out)
    assert lens.image_size_px == (320, 300)
    assert covariance is not None
    assert np.sqrt(covariance[0, 0]) == pytest.approx(record["parameters"]["fx_px"]["sigma"])


@pytest.mark.slow
def test_grey_levels_tell_more_than_circles(folder):
    images = [np.asarray(cv2.imread(path, cv2.IMREAD_GRAYSCALE)) for path in pictures(folder)]
    circles, pixels = (
        trinoc.calibrate_intrinsics(images, SHEET, distortion=2, method=method)
        for method in ("points", "pixels")
    )
    assert pixels.lens_parameters == circles.lens_parameters
    assert pixels.rms_px() == pytest.approx(circles.rms_px(), rel=0.2)
    for name, true in (("fx_px", 610.0), ("fy_px", 745.0), ("cx_px", 159.5), ("k1", -0.2)):
        assert pixels.sigma(name) < circles.sigma(name)
        assert abs(pixels.value(name) - true) < 5 * pixels.sigma(name)
    assert pixels.has_rig
    assert pixels.lens.image_size_px == (320, 300)
    assert trinoc.next_shot(pixels) is not None
    assert 0.7 < pixels.reduced_chi_square < 1.3


def test_what_grey_levels_cannot_do_is_said(folder):
    image = np.asarray(cv2.imread(pictures(folder)[0], cv2.IMREAD_GRAYSCALE))
    with pytest.raises(InputError, match="estimates both focal lengths"):
        trinoc.calibrate_intrinsics([image], SHEET, method="pixels", aspect="pitch")
    detection = trinoc.calib.detect_pattern(image, SHEET)
    with pytest.raises(InputError, match="is a detection without grey levels"):
        trinoc.calibrate_intrinsics([detection], SHEET, method="pixels")


def test_a_picture_without_sheet_is_named_and_one_alone_fails(folder, capsys):
    blank, sheet = str(folder / "blank.png"), ["--pattern", str(folder / "sheet.json")]
    out = ["-o", str(folder / "other.json"), "--distortion", "2"]
    assert main(["intrinsics", *pictures(folder), blank, *sheet, *out]) == 0
    assert "picture 6: No sheet" in capsys.readouterr().out
    assert main(["intrinsics", blank, *sheet]) == 1
    assert "found in no image" in capsys.readouterr().err
    assert main(["intrinsics", *sheet]) == 2


BOARDS = {
    "chessboard": trinoc.Chessboard(rows=5, columns=7, square_mm=20.0),
    "charuco": trinoc.Charuco(rows=6, columns=8, square_mm=20.0, marker_mm=15.0),
    "aprilgrid": trinoc.AprilGrid(rows=3, columns=4, tag_mm=30.0),
}
TURNS = [(35, 0, 5), (-35, 5, -8), (0, 35, 12), (3, -35, 0), (25, 25, -5), (-25, 25, 8)]


@pytest.mark.parametrize("name", BOARDS)
def test_every_board_becomes_a_lens(name, tmp_path, capsys):
    board, out = BOARDS[name], tmp_path / "camera.json"
    trinoc.save(board, tmp_path / "board.json")
    files = []
    for k, turn in enumerate(TURNS):
        pose = hold_board((10 * (k % 3 - 1), 8 * (k % 2), 380.0), turn, board)
        files.append(str(tmp_path / f"{k}.png"))
        cv2.imwrite(files[-1], board_picture("left", [pose], seed=k, board=board))
    options = ["--board", str(tmp_path / "board.json"), "--distortion", "1", "-o", str(out)]
    assert main(["intrinsics", *files, *options, "--json", "--quiet"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert record["pictures"] == len(TURNS)
    assert record["sigmas_include"][0] == "noise"
    focal = record["parameters"]["fx_px"]
    assert abs(focal["value"] - FOCAL_PX["left"]) < 5 * focal["sigma"] + 1.0
    lens, covariance = load_intrinsics(out), load_lens_covariance(out)
    assert lens.image_size_px == BOARD_SIZE_PX
    assert covariance is not None
