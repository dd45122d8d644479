"""Every command and every snippet of README and docs runs, as it stands, in an empty folder.

The blocks of a page run in their order, commands in this process and snippets in one namespace.
What a page takes from its reader comes from the page itself, from the demo, or from `GIVEN`.
"""

import contextlib
import glob
import importlib.util
import os
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

import trinoc
from simulation.camera_picture.layers import Paint
from simulation.camera_picture.render import render_sheet
from simulation.camera_picture.shapes import Cells
from tests.io.formats.bench import bench_matches, bench_rig
from tests.io.made_rims import made_rims
from tests.io.made_wireframe import made_wireframe
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.targets.squares import square_sheet
from trinoc.cli.main import main
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.io.demo import demo_paths, demo_pattern, demo_truth
from trinoc.io.images import read_image
from trinoc.synth.rigs import table1_rig

ROOT = Path(__file__).parents[1]
PAGES = {path.name: path for path in (*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md")}

# Commands that do not run here, and why. Each still stands on a page.
NOT_RUN = {
    "pip install .": "installs; .ci/run does it",
    "trinoc watch shots --board sheet.json": "waits for pictures until Ctrl-C",
    "trinoc watch left=0 right=1 --board chessboard.json -o rig.json --report report.html": (
        "takes cameras"
    ),
    "export TRINOC_DATA=DIR": "DIR is the reader's",
    "python benchmarks/make_data.py DIR": "a benchmark",
    "python benchmarks/render_pictures.py blocks DIR/blocks --seeds $(seq 0 29)": "needs POV-Ray",
    "python benchmarks/render_pictures.py blocks DIR/blocks_fine --seeds 100 101 102 "
    "--resolution 4": "needs POV-Ray",
    "python benchmarks/render_pictures.py colours DIR/colours --seeds $(seq 400 405)": (
        "needs POV-Ray"
    ),
    "python benchmarks/segments.py --scenes DIR/blocks --scenes DIR/blocks_fine "
    "--photographs DIR": "a benchmark",
    "python benchmarks/matching.py --rendered DIR/blocks --seeds 0 --no-files --no-times": (
        "a benchmark"
    ),
}

# Commands that take most of a minute here, which the slow test alone runs, on their page.
SLOW = {
    "trinoc check scene_upper.png scene_left.png scene_right.png --rig rig.json": "start.md",
    "trinoc calibrate-rig left=walls/left/ right=walls/right/ --board front.json "
    "--board back.json -o walls.json": "rigs.md",
}

LENS = trinoc.Intrinsics(
    focal_length_mm=12.0, pixel_pitch_mm=(0.015, 0.015), image_size_px=(640, 480)
)


# Ink of boards of squares is painted over a sheet that has none.
BARE: Any = SimpleNamespace(
    centres_mm=np.zeros((0, 2)), radius_mm=np.zeros(0), inner_radius_mm=np.zeros(0),
    line_width_mm=0.0, line_half_length_mm=(0.0, 0.0), line_style="stop", line_gap_mm=0.0,
)  # fmt: skip
INK = 25.0


def save_picture(path: str, board: AbstractTarget, cam_from_board: np.ndarray) -> None:
    camera, covers = Camera(LENS, Pose(cam_from_board)), ()
    drawn = board if isinstance(board, Pattern) else BARE
    if drawn is BARE:
        sheet = square_sheet(board)
        covers = (Paint(Cells(sheet.x_mm, sheet.y_mm, sheet.ink), INK),)
    picture = render_sheet(drawn, camera, ink=INK, covers=covers, supersampling=2)
    Path(path).parent.mkdir(exist_ok=True, parents=True)
    cv2.imwrite(path, picture)


def board_pose(shot: int, distance_mm: float) -> np.ndarray:
    """Pose cam_from_board of a board that faces the camera and leans differently in each shot."""
    about = 2.4 * shot
    lean = np.asarray(rotation_from_vector(np.array([0.6 * np.cos(about), 0.6 * np.sin(about), 0])))
    position = [30 * np.sin(about), 20 * np.cos(about), distance_mm]
    middle = lean @ np.diag([1.0, -1.0, -1.0])
    return np.c_[middle, position]


def chain(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    """The motion (3, 4) that is `first`, then `second`."""
    return np.c_[second[:, :3] @ first[:, :3], second[:, :3] @ first[:, 3] + second[:, 3]]


def give_videos() -> None:
    trinoc.save(table1_rig(), "rig.json")
    for view, path in demo_paths("scene").items():
        picture = read_image(path)
        height, width = picture.shape
        code = cv2.VideoWriter.fourcc(*"MJPG")
        writer = cv2.VideoWriter(f"{view}.avi", code, 10.0, (width, height), False)
        for _ in range(2):
            writer.write(picture)
        writer.release()


def give_shape() -> None:
    """The known shape of the demo's scene, as a table and as a model."""
    edges = demo_truth().edges_mm
    np.savetxt("edges.csv", edges.reshape(-1, 6), delimiter=",")
    corners = [f"v {x} {y} {z}" for x, y, z in edges.reshape(-1, 3)]
    lines = [f"l {2 * k + 1} {2 * k + 2}" for k in range(len(edges))]
    Path("part.obj").write_text("\n".join([*corners, *lines]) + "\n")


def give_shots() -> None:
    trinoc.save(demo_pattern(), "sheet.json")
    for shot in range(4):
        save_picture(f"lens/{shot}.png", demo_pattern(), board_pose(shot, 320.0))
    board = trinoc.Chessboard(rows=6, columns=9, square_mm=25)
    front = trinoc.AprilGrid(rows=4, columns=4, tag_mm=16)
    back = trinoc.AprilGrid(rows=4, columns=4, tag_mm=16, first=16)
    about_y = np.diag([-1.0, 1.0, -1.0])
    for shot in range(5):
        # One camera sees the front of a block, another from behind its back.
        front_pose = board_pose(shot, 330.0)
        back_in_front = np.c_[about_y, [0.0, 0.0, -30.0]]
        behind = np.c_[about_y, [0.0, 0.0, 660.0]]
        back_pose = chain(behind, chain(front_pose, back_in_front))
        save_picture(f"walls/left/{shot}.png", front, front_pose)
        save_picture(f"walls/right/{shot}.png", back, back_pose)
        for camera, aside in (("left", 0.0), ("right", -60.0)):
            moved = board_pose(shot, 520.0) + np.c_[np.zeros((3, 3)), [aside, 0.0, 0.0]]
            save_picture(f"{camera}/{shot}.png", board, moved)


def give_values() -> None:
    trinoc.save(bench_rig(coefficients=4), "rig.json")
    trinoc.save(bench_rig()["upper"].intrinsics, "camera.json")
    trinoc.save(bench_matches(), "matches.npz")
    trinoc.save(made_wireframe(), "wireframe.npz")
    trinoc.save(made_rims(), "rims.npz")
    trinoc.save(trinoc.Segments.from_endpoints(np.array([[1.0, 2, 3, 4]])), "segments.npz")


# What a page takes from its reader.
GIVEN: dict[str, Callable[[], None]] = {
    "evaluate.md": give_shape,
    "formats.md": give_values,
    "recordings.md": give_videos,
    "rigs.md": give_shots,
}


def blocks(page: Path) -> list[tuple[str, str]]:
    """Pairs (language, text) of the code blocks of a page, in order."""
    return re.findall(r"^```(sh|python)\n(.*?)^```", page.read_text(encoding="utf-8"), re.M | re.S)


def commands(block: str) -> list[list[str]]:
    """The words of each command, split by the rules of a shell."""
    command_list = []
    for line in block.replace("\\\n", " ").splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="&")
        lexer.whitespace_split = True
        tokens = list(lexer)
        while tokens:
            end = tokens.index("&&") if "&&" in tokens else len(tokens)
            command_list.append(tokens[:end])
            tokens = tokens[end + 1 :]
    return command_list


# Where several pages begin. It runs as it stands in an empty folder, once for all of them.
DEMO = ["trinoc", "demo", "--keep-inputs"]


def run_command(command: list[str], demo: Path) -> None:
    if command == DEMO and not os.listdir():
        shutil.copytree(demo, "trinoc-demo")
        return
    if command[0] == "cd":
        os.chdir(command[1])
        return
    assert command[0] == "trinoc", command
    if "parquet" in command and importlib.util.find_spec("pyarrow") is None:
        return
    paths = [sorted(glob.glob(word)) if "*" in word else [word] for word in command[1:]]
    assert main([word for group in paths for word in group]) == 0, command


# Pages that begin in the folder of pictures which `trinoc demo --keep-inputs` leaves.
BESIDE_THE_DEMO = {"evaluate.md", "how-to.md", "matching.md", "refine.md", "segments.md"}


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with contextlib.chdir(tmp_path_factory.mktemp("demo")):
        assert main(DEMO[1:]) == 0
        return Path("trinoc-demo").absolute()


def run_page(name: str, left_out: set[str], demo: Path) -> None:
    """Run every code block of a page except the commands in `left_out`."""
    if name in BESIDE_THE_DEMO:
        shutil.copytree(demo, "trinoc-demo")
        os.chdir("trinoc-demo/inputs")
    if name in GIVEN:
        GIVEN[name]()
    namespace: dict[str, object] = {}
    for language, text in blocks(PAGES[name]):
        if language == "python":
            exec(compile(text, name, "exec"), namespace)
        else:
            for command in commands(text):
                if " ".join(command) not in left_out:
                    run_command(command, demo)


@pytest.fixture(autouse=True)
def empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")


@pytest.mark.parametrize("name", [name for name, page in PAGES.items() if blocks(page)])
def test_what_a_page_says_runs(name: str, demo: Path) -> None:
    run_page(name, {*NOT_RUN, *SLOW}, demo)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(SLOW.values())))
def test_its_slow_commands_run_too(name: str, demo: Path) -> None:
    run_page(name, set(NOT_RUN), demo)


def test_what_does_not_run_stands_on_a_page() -> None:
    shown = {
        " ".join(command)
        for page in PAGES.values()
        for language, text in blocks(page)
        if language == "sh"
        for command in commands(text)
    }
    assert {*NOT_RUN, *SLOW} <= shown
