"""Write the public image sets of calibration boards that public_sets.toml lists.

    python benchmarks/public_sets_collect.py CLONES FOLDER [--shared DIR] [--only NAME ...]

CLONES/owner/name is a git clone or a bare git directory of each source, with the listed commit.
Writes FOLDER/NAME/CAMERA/SHOT.png (or .jpg, as in the source) and FOLDER/NAME/board.json, which
`trinoc calibrate-rig CAMERA=FOLDER/NAME/CAMERA --board FOLDER/NAME/board.json` reads. A camera's
folder that already holds files is left as it is. Sets whose source is "shared data" are linked
from --shared DIR, and skipped without it.

The name of a shot is the text that stands for the `*` in the camera's pattern, so files of one
moment have equal names in the folders of all cameras. At most 30 shots are written, chosen evenly.
Where two cameras share shots, only these are written.
"""

import argparse
import os
import re
import subprocess
import tempfile
import tomllib
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2

from trinoc.calib.targets.board_set import BOARDS
from trinoc.calib.targets.pattern import Pattern
from trinoc.io.board_json import load_target, save_target

LISTED = Path(__file__).with_name("public_sets.toml")
SHARED = "shared data"
MOST_SHOTS = 30
VIDEOS = {".mp4", ".avi", ".mov", ".mkv"}


def git(directory: Path, *arguments: str) -> bytes:
    """Output of a git command in a repository."""
    return subprocess.run(
        ["git", "-C", str(directory), *arguments], check=True, capture_output=True
    ).stdout


def shots_of_pattern(pattern: str, paths: list[str]) -> dict[str, str]:
    """Paths that match a pattern, by the name of the shot."""
    parts = [re.escape(part) for part in pattern.split("*")]
    expression = re.compile("([^/]*)".join(parts))
    matches = (expression.fullmatch(path) for path in paths)
    shots = {"_".join(filter(None, match.groups())): match.string for match in matches if match}
    return dict(sorted(shots.items(), key=lambda shot: in_reading_order(shot[0])))


def in_reading_order(name: str) -> list[tuple[int, str]]:
    """Sort key of a name by which 2 comes before 10."""
    parts = re.split(r"(\d+)", name)
    return [(int(part or 0), "") if part.isdigit() else (0, part) for part in parts]


def even_choice(names: list[str]) -> set[str]:
    """At most MOST_SHOTS of the names, evenly spaced."""
    count = min(len(names), MOST_SHOTS)
    return {names[(2 * k + 1) * len(names) // (2 * count)] for k in range(count)}


def chosen_shots(cameras: dict[str, dict[str, str]], *, one_moment: bool) -> dict[str, set[str]]:
    """Shots to write, by camera: those that two cameras took, or each camera's own.

    one_moment : false where shots of equal names are not of one moment.
    """
    counts = Counter(name for shots in cameras.values() for name in shots)
    common = [name for name, count in counts.items() if count > 1]
    if common and one_moment:
        selection = even_choice(sorted(common, key=in_reading_order))
        return dict.fromkeys(cameras, selection)
    return {camera: even_choice(list(shots)) for camera, shots in cameras.items()}


def write_video_frames(video: Path, folder: Path, step: int) -> None:
    """Write each step-th frame of a video as a PNG file."""
    capture = cv2.VideoCapture(str(video))
    number = 0
    while capture.grab():
        if number % step == 0:
            _, frame = capture.retrieve()
            cv2.imwrite(str(folder / f"{number:06d}.png"), frame)
        number += 1


def board_document(values: dict[str, Any], name: str) -> Any:
    """The board that an entry describes, as an object of trinoc."""
    fields = dict(values)
    kind = fields.pop("kind")
    if kind == "circles":
        return Pattern.circle_grid(**fields, name=name)
    if kind == "asymmetric_circles":
        return Pattern.asymmetric_circle_grid(**fields, name=name)
    board = BOARDS[kind]
    return board(**{board.layout[key]: value for key, value in fields.items()}, name=name)


def collect(entry: dict[str, Any], clones: Path, folder: Path, shared: Path | None) -> None:
    """Write the images and the board of one set."""
    set_folder = folder / entry["name"]
    set_folder.mkdir(parents=True, exist_ok=True)
    if "board" in entry:
        save_target(board_document(entry["board"], entry["name"]), set_folder / "board.json")
        load_target(set_folder / "board.json")
    if entry["source"] == SHARED:
        if shared is None:
            return
        paths = sorted(str(path.relative_to(shared)) for path in shared.rglob("*.*"))
        write = linker(shared)
    else:
        repository, commit = clones / entry["source"], entry["commit"]
        listed = git(repository, "ls-tree", "-r", "-z", "--name-only", commit)
        paths = listed.decode(errors="replace").split("\0")
        write = extractor(repository, commit)
    cameras = {
        camera: shots_of_pattern(pattern, paths) for camera, pattern in entry["cameras"].items()
    }
    shots_to_write = chosen_shots(cameras, one_moment=entry.get("one_moment", True))
    for camera, shots in cameras.items():
        target = set_folder / camera
        if not shots:
            raise SystemExit(f"{entry['name']}: no file matches the pattern of {camera!r}.")
        target.mkdir(exist_ok=True)
        if any(target.iterdir()):
            continue
        for name, path in shots.items():
            suffix = Path(path).suffix.lower()
            if suffix in VIDEOS:
                with tempfile.TemporaryDirectory() as temporary:
                    video = Path(temporary) / f"video{suffix}"
                    write(path, video)
                    write_video_frames(video, target, int(entry["frames"].removeprefix("every ")))
            elif name in shots_to_write[camera]:
                write(path, target / f"{name}{suffix}")
    counts = ", ".join(
        f"{camera} {len(list((set_folder / camera).iterdir()))}" for camera in cameras
    )
    print(f"{entry['name']}: {counts}")


def linker(shared: Path) -> Callable[[str, Path], None]:
    """A function that links a file of the shared data to a target path."""

    def write(path: str, target: Path) -> None:
        os.symlink(shared / path, target)

    return write


def extractor(repository: Path, commit: str) -> Callable[[str, Path], None]:
    """A function that writes a file of a commit to a target path. Files it lacks are left out."""

    def write(path: str, target: Path) -> None:
        try:
            target.write_bytes(git(repository, "show", f"{commit}:{path}"))
        except subprocess.CalledProcessError:
            print(f"{path} of {repository.name} is not in the clone.")

    return write


def main() -> None:
    """Collect all sets, or those named by --only."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clones", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shared", type=Path, default=None)
    parser.add_argument("--only", nargs="*", default=())
    options = parser.parse_args()
    for entry in tomllib.loads(LISTED.read_text())["set"]:
        if not options.only or entry["name"] in options.only:
            collect(entry, options.clones, options.folder, options.shared)


if __name__ == "__main__":
    main()
