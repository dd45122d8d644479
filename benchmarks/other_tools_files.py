"""Difference in pixels between trinoc and other tools that read the files of trinoc.

    python benchmarks/other_tools_files.py [--mrcal-python /usr/bin/python3]

Random rigs are exported; each tool's own library reads its file and projects points with its own
code. pycolmap and aniposelib are used where they are installed. mrcal is Debian's (python3-mrcal),
whose NumPy is another: it runs in its own interpreter. aniposelib and mrcal also write their files
again, which trinoc reads. Exits with 1 where a pixel differs by more than 1e-9 px, or by 1e-5 px
after mrcal has written ten digits of each number.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import cv2
import jax
import numpy as np

from trinoc.geometry import project
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io import FORMATS

AGREES_PX, AGAIN_PX = 1e-9, 1e-5
AGAIN = "mrcal writes it again, trinoc reads"
POINTS_MM = np.random.default_rng(0).uniform((-60, -60, 0), (60, 60, 60), (200, 3))
# Reads each model, projects the points with mrcal, and writes the model again.
MRCAL = """
import json, sys
import mrcal, numpy as np
points = np.array(json.load(sys.stdin)) / 1000
for name in sys.argv[1:]:
    model = mrcal.cameramodel(name)
    seen = mrcal.transform_point_rt(model.extrinsics_rt_fromref(), points)
    print(json.dumps(mrcal.project(seen, *model.intrinsics()).tolist()))
    model.write(name)
"""


def main() -> int:
    """Print a row for each reader. Returns 0 if all agree."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rigs", type=int, default=20, help="random rigs of three cameras")
    parser.add_argument("--mrcal-python", help="an interpreter that has mrcal")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    readers: dict[str, Callable[[Rig, Path], float]] = {
        "opencv (YAML), cv2.FileStorage and projectPoints": lambda r, d: by_cv2(r, d / "rig.yml"),
        "opencv (JSON), cv2.FileStorage and projectPoints": lambda r, d: by_cv2(r, d / "rig.json"),
    }
    if importlib.util.find_spec("pycolmap"):
        readers["colmap, pycolmap"] = lambda r, d: by_pycolmap(r, d / "bin", "colmap")
        readers["colmap-text, pycolmap"] = lambda r, d: by_pycolmap(r, d / "txt", "colmap-text")
    if importlib.util.find_spec("aniposelib"):
        readers["anipose, aniposelib"] = lambda r, d: by_aniposelib(r, d / "anipose.toml")
        readers["anipose, fisheyes, aniposelib"] = lambda r, d: by_aniposelib(
            fisheyes(r), d / "fisheyes.toml"
        )
        readers["aniposelib writes them again, trinoc reads"] = lambda r, d: max(
            anipose_again(r, d / "anipose.toml"), anipose_again(fisheyes(r), d / "fisheyes.toml")
        )
    if options.mrcal_python:
        python = options.mrcal_python
        readers["mrcal, mrcal.project"] = lambda r, d: by_mrcal(r, d / "models", python)
        readers[AGAIN] = lambda r, d: again(r, d / "models")
    worst = dict.fromkeys(readers, 0.0)
    for seed in range(options.rigs):
        rig = random_rig(np.random.default_rng(seed))
        with tempfile.TemporaryDirectory() as folder:
            for name, read in readers.items():
                worst[name] = max(worst[name], read(rig, Path(folder)))
    print(f"{3 * options.rigs} cameras, {len(POINTS_MM)} points each\n")
    print("| file, reader | largest difference (px) |\n|---|---|")
    for name, difference in worst.items():
        print(f"| {name} | {difference:.1e} |")
    agree = (
        largest <= (AGAIN_PX if name == AGAIN else AGREES_PX) for name, largest in worst.items()
    )
    return 0 if all(agree) else 1


def random_rig(random: np.random.Generator) -> Rig:
    """Three cameras of a bench, with distortion."""
    return Rig(
        {
            name: Camera.from_degrees(
                Intrinsics(
                    image_size_px=(1280, 960),
                    focal_length_px=random.uniform(800, 3000, 2),
                    principal_point_px=random.uniform(400, 600, 2),
                    distortion=random.uniform(-1, 1, 5) * (0.3, 0.1, 0.01, 0.01, 0.05),
                ),
                pan_deg=random.uniform(-170, 170),
                tilt_deg=random.uniform(15, 80),
                swing_deg=random.uniform(-170, 170),
                distance_mm=random.uniform(250, 900),
            )
            for name in ("upper", "left", "right")
        }
    )


def pixels(camera: Camera) -> np.ndarray:
    """Pixels at which trinoc images the points."""
    return np.asarray(jax.vmap(project, (None, 0))(camera, POINTS_MM))


def by_cv2(rig: Rig, path: Path) -> float:
    """Largest difference in pixels of OpenCV, which reads the rig."""
    FORMATS["opencv"].save(rig, path)
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    cameras = storage.getNode("cameras")
    differences = []
    for number, camera in enumerate(rig.cameras):
        node = cameras.at(number)
        keys = ("R", "T", "camera_matrix", "distortion_coefficients")
        rotation, translation, matrix, distortion = (node.getNode(key).mat() for key in keys)
        in_camera = POINTS_MM @ rotation.T + translation.ravel()
        images, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix, distortion)
        differences.append(np.abs(images.reshape(-1, 2) - pixels(camera)).max())
    return max(differences)


def by_pycolmap(rig: Rig, path: Path, name: str) -> float:
    """Largest difference in pixels of COLMAP, which reads the model with its rig and frame."""
    import pycolmap

    FORMATS[name].save(rig, path)
    model = pycolmap.Reconstruction(str(path))
    differences = []
    for camera_name, camera in rig.items():
        image = model.find_image_with_name(camera_name)
        pose = image.cam_from_world().matrix()
        images = model.cameras[image.camera_id].img_from_cam(POINTS_MM @ pose[:, :3].T + pose[:, 3])
        differences.append(np.abs(np.asarray(images) - 0.5 - pixels(camera)).max())
    return max(differences)


def fisheyes(rig: Rig) -> Rig:
    """The same cameras with the Kannala-Brandt lens model."""
    cameras = {}
    for number, (name, camera) in enumerate(rig.items()):
        lens = Intrinsics(
            image_size_px=camera.image_size_px,
            focal_length_px=camera.intrinsics.focal_length_px,
            principal_point_px=camera.intrinsics.principal_point_px,
            distortion=(0.02 * number, -0.01, 0.002, -0.0003),
            distortion_model="kannala_brandt",
        )
        cameras[name] = Camera(lens, camera.pose)
    return Rig(cameras)


def by_aniposelib(rig: Rig, path: Path) -> float:
    """Largest difference in pixels of aniposelib, which reads the cameras and rewrites them."""
    from aniposelib.cameras import CameraGroup

    FORMATS["anipose"].save(rig, path)
    group = CameraGroup.load(path)
    if group.get_names() != list(rig.names):
        raise SystemExit("aniposelib reads other names.")
    images = group.project(POINTS_MM)
    group.dump(path.with_name(f"again_{path.name}"))
    return max(
        np.abs(uv.reshape(-1, 2) - pixels(camera)).max()
        for uv, camera in zip(images, rig.cameras, strict=True)
    )


def anipose_again(rig: Rig, path: Path) -> float:
    """Largest difference in pixels after trinoc reads the file that aniposelib wrote."""
    back = FORMATS["anipose"].load(path.with_name(f"again_{path.name}"))
    return max(np.abs(pixels(back[name]) - pixels(camera)).max() for name, camera in rig.items())


def by_mrcal(rig: Rig, path: Path, python: str) -> float:
    """Largest difference in pixels of mrcal, which reads the models."""
    FORMATS["mrcal"].save(rig, path)
    files = [str(path / f"{name}.cameramodel") for name in rig]
    points = json.dumps(POINTS_MM.tolist())
    done = subprocess.run(
        [python, "-c", MRCAL, *files], input=points, capture_output=True, text=True, check=True
    )
    images = [np.array(json.loads(line)) for line in done.stdout.splitlines()]
    return max(
        np.abs(uv - pixels(camera)).max() for uv, camera in zip(images, rig.cameras, strict=True)
    )


def again(rig: Rig, path: Path) -> float:
    """Largest difference in pixels after trinoc reads the files that mrcal wrote."""
    back = FORMATS["mrcal"].load(path)
    return max(np.abs(pixels(back[name]) - pixels(camera)).max() for name, camera in rig.items())


if __name__ == "__main__":
    sys.exit(main())
