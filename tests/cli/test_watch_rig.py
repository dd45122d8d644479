"""`trinoc watch` of several cameras: made videos, folders and cameras, to the rig."""

import functools
import json
import shlex
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.capture.made_boards import (
    FOCAL_PX,
    SHEET,
    SIZE_PX,
    board_picture,
    hold_board,
    matrix,
    move_poses,
)
from trinoc.cli.main import main
from trinoc.geometry.rig import Rig
from trinoc.io.board_json import save_target
from trinoc.io.images import load_shots

CAMERAS = tuple(FOCAL_PX)
# Places before the left camera in mm, and turns about the camera's axes in degrees.
HELD = (
    ((70.0, 0.0, 330.0), (25.0, 0.0, 0.0)),
    ((20.0, 40.0, 360.0), (0.0, 30.0, 5.0)),
    ((120.0, -40.0, 380.0), (-30.0, 0.0, -5.0)),
    ((20.0, -40.0, 380.0), (0.0, -30.0, 0.0)),
    ((120.0, 40.0, 360.0), (25.0, -20.0, 10.0)),
    ((70.0, 40.0, 340.0), (-25.0, 25.0, 0.0)),
)
POSES = [hold_board(*placement) for placement in HELD]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    save_target(SHEET, tmp_path / "board.json")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@functools.cache
def picture_of(camera: str, pose_number: int, seed: int) -> np.ndarray:
    """The image in which a camera sees the board in one of POSES."""
    return board_picture(camera, [POSES[pose_number]], seed)


def write_video(file: str, frames: list[np.ndarray], frames_per_s: float) -> None:
    code = cv2.VideoWriter.fourcc(*"MJPG")
    writer = cv2.VideoWriter(file, code, frames_per_s, SIZE_PX, False)
    for frame in frames:
        writer.write(frame)
    writer.release()


def watch(*options: str) -> int:
    return main(("watch", *options, "--board", "board.json", "--port", "none"))


SMEAR_MM = 8.0


@functools.cache
def waved_frames(camera: str) -> list[np.ndarray]:
    """Frames of a board that rests once a second. It moves in two of three frames."""
    frames = []
    for second, pose in enumerate(POSES):
        moved = [
            board_picture(camera, move_poses(pose, by, steps=5), 3 * second + k)
            for k, by in enumerate(((SMEAR_MM, 0.0, 0.0), (0.0, SMEAR_MM, 0.0)))
        ]
        at_rest = board_picture(camera, [pose], 3 * second + 2)
        frames += [*moved[: second % 3], at_rest, *moved[second % 3 :]]
    return frames


def true_rig(first: np.ndarray) -> Rig:
    """The true rig, with the board of the first shot as the world."""
    motion = np.vstack([first, [0.0, 0.0, 0.0, 1.0]])
    return Rig.from_matrices(
        {name: matrix(name) @ motion for name in CAMERAS}, image_size_px=SIZE_PX
    )


@pytest.fixture
def waved(folder: Path) -> tuple[str, ...]:
    """The command line arguments of the videos of a waved board."""
    for name in CAMERAS:
        write_video(f"{name}.avi", waved_frames(name), 3.0)
    return tuple(f"{name}={name}.avi" for name in CAMERAS)


def test_of_a_waved_board_the_frames_at_rest_are_kept(waved, folder, capsys) -> None:
    assert watch(*waved, "--keep", "kept", "--json", "--quiet") == 0
    record = json.loads(capsys.readouterr().out)
    # At rest is the frame of number second % 3 in each second.
    at_rest = [f"{second + (second % 3) / 3:.2f} s" for second in range(len(POSES))]
    assert [shot["name"] for shot in record["shots"]] == at_rest
    names = [f"shot_{k:04d}" for k in range(1, 1 + len(POSES))]
    assert [shot["kept"] for shot in record["shots"]] == names
    shots = load_shots({name: folder / "kept" / name for name in CAMERAS})
    assert {name: list(camera_shots) for name, camera_shots in shots.items()} == dict.fromkeys(
        CAMERAS, names
    )
    capture = cv2.VideoCapture("right.avi")
    frames = [capture.read()[1] for _ in range(3 * len(POSES))]
    for second, name in enumerate(names):
        frame = frames[3 * second + second % 3]
        np.testing.assert_array_equal(shots["right"][name](), frame[..., 0])


@pytest.mark.slow
def test_a_waved_board_gives_the_rig(waved, folder, capsys) -> None:
    assert watch(*waved, "-o", "rig.json", "--report", "report.html", "--json", "--quiet") == 0
    record = json.loads(capsys.readouterr().out)
    assert record["written"] == ["rig_shots", "rig.json", "report.html"]
    assert "shots" in (folder / "report.html").read_text()
    parameters = record["calibration"]["parameters"]
    assert record["calibration"]["world"] == "the board in shot_0001"
    truth = true_rig(POSES[0])
    for name in CAMERAS:
        camera = truth[name]
        exact = {
            "fx_px": FOCAL_PX[name],
            "fy_px": FOCAL_PX[name],
            "cx_px": (SIZE_PX[0] - 1) / 2,
            "cy_px": (SIZE_PX[1] - 1) / 2,
            "pan_deg": camera.pan_deg,
            "tilt_deg": camera.tilt_deg,
            "swing_deg": camera.swing_deg,
            "distance_mm": camera.distance_mm,
        }
        for key, value in exact.items():
            estimate = parameters[f"{name}.{key}"]
            assert abs(estimate["value"] - value) < 4.0 * estimate["sigma"], (
                name,
                key,
                estimate,
                value,
            )
            assert estimate["sigma"] < 0.02 * max(abs(value), 100.0)


class MadeCameras:
    """Two cameras that show a board in some of POSES, one after the other, until it is stopped."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, pose_numbers: Sequence[int]) -> None:
        self.pose_numbers, self.opened = pose_numbers, []
        monkeypatch.setattr(cv2, "VideoCapture", self.open)

    def open(self, number: int) -> "MadeCamera":
        self.opened.append(number)
        return MadeCamera(CAMERAS[number], self.pose_numbers)


class MadeCamera:
    def __init__(self, name: str, pose_numbers: Sequence[int]) -> None:
        self.name, self.pose_numbers, self.count = name, pose_numbers, -1

    def isOpened(self) -> bool:
        return True

    def grab(self) -> bool:
        self.count += 1
        if self.count == len(self.pose_numbers):
            raise KeyboardInterrupt
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, picture_of(self.name, self.pose_numbers[self.count], self.count)

    def release(self) -> None:
        self.name = ""


TWO = ("left=0", "right=1", "--every-s", "1e-9")


def test_too_few_shots_are_kept_and_gone_on_with(folder, capsys, monkeypatch) -> None:
    MadeCameras(monkeypatch, range(2))
    assert watch(*TWO, "-o", "rig.json") == 1
    out, err = capsys.readouterr()
    assert "picture 1: kept as shot_0001; left good, right good" in out
    assert 'there are only 2 good pictures of "left"' in err
    assert not (folder / "rig.json").exists()
    assert len(list((folder / "rig_shots" / "right").iterdir())) == 2
    # The same again would mix what was kept with what may be of other cameras.
    assert watch(*TWO, "-o", "rig.json") == 2
    assert "continue that run with --keep rig_shots" in capsys.readouterr().err
    # What it says to type.
    MadeCameras(monkeypatch, range(1, 3))
    advised = shlex.split(err.partition("To continue, run: ")[2])
    assert advised[:2] == ["trinoc", "watch"]
    calibrated = []

    def calibrate(folder_by_camera: dict[str, Path], *_: object) -> None:
        calibrated.append(folder_by_camera)
        raise KeyboardInterrupt

    monkeypatch.setattr("trinoc.cli.watch.calibrate_shots", calibrate)
    assert main(advised[1:]) == 130
    out, err = capsys.readouterr()
    assert "shot_0001: kept as shot_0001" in out
    assert "picture 1: nothing new" in out
    assert "picture 2: kept as shot_0003" in out
    assert calibrated == [{name: Path("rig_shots", name) for name in ("left", "right")}]
    assert "Interrupted: The shots are kept in rig_shots. To continue, run: trinoc watch" in err


def test_a_camera_that_is_pulled_out_does_not_lose_the_shots(folder, capsys, monkeypatch) -> None:
    MadeCameras(monkeypatch, range(3))
    monkeypatch.setattr(MadeCamera, "grab", _grab_until_pulled)
    assert watch(*TWO, "-o", "rig.json") == 1
    err = capsys.readouterr().err
    assert "Camera 0 stopped sending pictures" in err
    assert "there are only 2 good pictures" in err


def _grab_until_pulled(camera: MadeCamera) -> bool:
    camera.count += 1
    return camera.count < 2


@pytest.fixture
def folders(folder: Path) -> Path:
    """Two shots of both cameras, and one of the left alone."""
    for camera in CAMERAS:
        (folder / camera).mkdir()
        for k in range(3 if camera == "left" else 2):
            picture = picture_of(camera, k, k)
            assert cv2.imwrite(str(folder / camera / f"{camera}_{k:02d}.png"), picture)
    return folder


def test_files_of_folders_are_paired_by_their_names(folders, capsys) -> None:
    assert watch("left=left", "right=right", "--once", "--keep", "kept", "--json", "--quiet") == 0
    record = json.loads(capsys.readouterr().out)
    cameras = {shot["name"]: tuple(shot["cameras"]) for shot in record["shots"]}
    assert cameras == {"00": CAMERAS, "01": CAMERAS, "02": ("left",)}
    assert {path.name for path in (folders / "kept" / "left").iterdir()} == {
        f"shot_{k:04d}.png" for k in (1, 2, 3)
    }
    first = cv2.imread(str(folders / "kept" / "right" / "shot_0001.png"), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(first, picture_of("right", 0, 0))
    assert record["next"] == "Hold the board where left sees it together with right."


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("left=0", "right=left"), "cannot be combined"),
        (("left=0", "right=0"), "the same source"),
        (("left", "right"), "write NAME=FILE"),
        (("../x=left", "b=right", "--keep", "kept"), "not allowed as the name of a folder"),
        (("left=left", "--report", "r.html"), "give the output file of the rig with -o"),
        (("left=left", "right=right", "--keep", "."), "a folder that is watched"),
        (("0", "-o", "rig.json", "--report", "r.html"), "such as camera=0"),
        (("left=board.json",), "no video that OpenCV reads"),
        (("left=board.json", "right=nowhere.avi"), "nowhere.avi does not exist"),
        (("left=nowhere",), "nowhere is not a folder"),
        (("left=left", "-o", "board.json"), "which is an input and would be overwritten"),
        (("left=left", "-o", "no/rig.json"), "does not exist: create it first"),
        ((), "No source is given"),
    ],
)
def test_what_cannot_be_watched_is_said_before_anything_is(
    options, message, folders, capsys
) -> None:
    assert watch(*options) in (1, 2)
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert not (folders / "kept").exists()


def test_videos_have_to_be_in_step(folder, capsys) -> None:
    image = picture_of("left", 0, 0)
    for name, count, rate in (("a", 2, 3.0), ("b", 2, 4.0), ("c", 5, 3.0)):
        write_video(f"{name}.avi", count * [image], rate)
    assert watch("left=a.avi", "right=b.avi") == 1
    assert "3 frames a second and b.avi 4" in capsys.readouterr().err
    assert watch("left=a.avi", "right=c.avi") == 0
    out, err = capsys.readouterr()
    assert "c.avi has 5 frames and a.avi 2" in err
    assert out.startswith(("0.00 s: nothing new", "0.33 s: nothing new"))


def test_one_video_without_a_name_is_judged_as_one_camera(folder, capsys) -> None:
    write_video("left.avi", waved_frames("left")[:6], 3.0)
    assert watch("left.avi", "--json", "--quiet") == 0
    assert [each["good"] for each in json.loads(capsys.readouterr().out)["pictures"]] == [True] * 2
