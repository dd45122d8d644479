"""Write the public real scenes that real_scenes.toml lists: pictures, camera files, rig.json.

    python benchmarks/real_scenes_collect.py CLONES FOLDER [--only NAME ...]

CLONES/owner/name is a git clone or a bare git directory of each source, with the listed commit.
Writes FOLDER/NAME/VIEW.png, made smaller by the whole number `smaller` of the entry, the camera
files as the source has them in FOLDER/NAME/cameras, and FOLDER/NAME/rig.json of the pictures
as written. `real_scenes.py` reads them. A scene that has a rig.json is left as it is.
"""

import argparse
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import trinoc
from trinoc.io.formats.registry import FORMATS

LISTED = Path(__file__).with_name("real_scenes.toml")


def git(directory: Path, *arguments: str) -> bytes:
    """Output of a git command in a repository."""
    return subprocess.run(
        ["git", "-C", str(directory), *arguments], check=True, capture_output=True
    ).stdout


def strecha_projection(path: Path) -> np.ndarray:
    """Projection of a .camera file: K, three zeros, camera axes in the world, centre in m, size."""
    numbers = np.array(path.read_text().split(), float)
    calibration, axes = numbers[:9].reshape(3, 3), numbers[12:21].reshape(3, 3)
    return calibration @ np.c_[axes.T, axes.T @ (-1000.0 * numbers[21:24])]


def cameras_of(
    entry: dict[str, Any], folder: Path, sizes: dict[str, tuple[int, int]]
) -> trinoc.Rig:
    """The cameras of an entry by the name of the view, of the pictures in full size."""
    views: dict[str, str] = entry["views"]
    if entry["cameras"] == "strecha":
        files = {view: folder / f"{name}.camera" for view, name in views.items()}
        matrices = {view: strecha_projection(file) for view, file in files.items()}
        return trinoc.Rig.from_matrices(matrices, sizes)
    if entry["cameras"] == "idr":
        with np.load(next(folder.glob("*.npz"))) as arrays:
            numbers = {view: int(Path(name).stem) for view, name in views.items()}
            matrices = {view: arrays[f"world_mat_{k}"][:3] for view, k in numbers.items()}
        return trinoc.Rig.from_matrices(matrices, sizes)
    form = FORMATS[entry["cameras"]]
    file = folder if form.place == "folder" else next(folder.glob("*.json"))
    rig = form.read(file, entry.get("unit_mm", form.unit_mm), None)
    by_stem = {Path(name).stem: camera for name, camera in rig.items()}
    return trinoc.Rig({view: by_stem[Path(name).stem] for view, name in views.items()})


def smaller_camera(camera: trinoc.Camera, size: tuple[int, int]) -> trinoc.Camera:
    """Camera of the same picture, resized to another size."""
    lens = camera.intrinsics
    factor = np.array(size) / lens.image_size_px
    resized = trinoc.Intrinsics(
        image_size_px=size,
        focal_length_px=np.asarray(lens.focal_length_px) * factor,
        principal_point_px=(np.asarray(lens.principal_point_px) + 0.5) * factor - 0.5,
        skew_px=float(lens.skew_px) * factor[0],
        distortion=np.asarray(lens.distortion) if lens.has_distortion else None,
        distortion_model=lens.distortion_model if lens.has_distortion else None,
    )
    return trinoc.Camera(resized, camera.pose)


def collect(entry: dict[str, Any], clones: Path, folder: Path) -> None:
    """Write one scene."""
    scene = folder / entry["name"]
    if (scene / "rig.json").exists():
        return
    (scene / "cameras").mkdir(parents=True, exist_ok=True)
    repository, commit = clones / entry["source"], entry["commit"]
    for path in entry["camera_files"]:
        content = git(repository, "show", f"{commit}:{path}")
        (scene / "cameras" / Path(path).name).write_bytes(content)
    sizes, small = {}, {}
    for view, path in entry["views"].items():
        content = git(repository, "show", f"{commit}:{entry['pictures']}/{path}")
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        height, width = picture.shape[:2]
        by = entry.get("smaller", 1)
        sizes[view], small[view] = (width, height), (width // by, height // by)
        if by > 1:
            cut = picture[: height // by * by, : width // by * by]
            picture = cv2.resize(cut, small[view], interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(scene / f"{view}.png"), picture)
    cameras = cameras_of(entry, scene / "cameras", sizes)
    for view, camera in cameras.items():
        if tuple(camera.image_size_px) != sizes[view]:
            print(f"{entry['name']} {view}: camera {camera.image_size_px}, picture {sizes[view]}.")
    rig = trinoc.Rig(
        {view: smaller_camera(camera, small[view]) for view, camera in cameras.items()}
    )
    trinoc.save(rig, scene / "rig.json")
    print(f"{entry['name']}: {len(rig)} views, {next(iter(small.values()))} px")


def main() -> None:
    """Collect all scenes, or those named by --only."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("clones", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="*", default=())
    options = parser.parse_args()
    for entry in tomllib.loads(LISTED.read_text())["scene"]:
        if not options.only or entry["name"] in options.only:
            collect(entry, options.clones, options.folder)


if __name__ == "__main__":
    main()
