"""EasyMocap's folder with intri.yml and extri.yml, in OpenCV's FileStorage.

Both files have the list `names`. intri.yml has `K_NAME`, `dist_NAME`, `H_NAME` and `W_NAME` for
each camera. extri.yml has `R_NAME` (rotation vector), `Rot_NAME` (the same rotation as a matrix)
and `T_NAME` of x_cam = R x_world + T.

Source: mytools/camera_utils.py of EasyMocap.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.formats.cv_storage import read_storage, write_storage
from trinoc.io.formats.format import COVARIANCE, METRE_MM, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys
from trinoc.io.formats.lens_rows import list_lens_numbers
from trinoc.io.formats.motions import motion, rotation_of_vector, rotation_vector
from trinoc.io.formats.opencv_lens import (
    WRITTEN,
    flat_numbers,
    matrix_of_numbers,
    read_opencv_lens,
)
from trinoc.io.formats.text_files import atomic_folder
from trinoc.io.json_document import Block

TITLE = "EasyMocap's intri.yml and extri.yml"
INTRINSIC, EXTRINSIC = "intri.yml", "extri.yml"
# What EasyMocap lists where no camera is.
NO_CAMERA = "none"
# How far the two statements of one rotation may differ: they have six decimals.
_SAME = 1e-4
KEYS = Keys(read=("K", "dist", "D", "H", "W", "R", "Rot", "T"))


def write_easymocap(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write intri.yml and extri.yml into the folder `path`; translations in units of `unit_mm`."""
    intrinsic: dict[str, Any] = {"names": list(rig.names)}
    extrinsic: dict[str, Any] = {"names": list(rig.names)}
    for name, camera in rig.items():
        if not re.fullmatch(r"[A-Za-z0-9_-]+", name) or name == NO_CAMERA:
            raise InputError(
                f'The name of the camera "{name}" becomes a part of keys in {TITLE}: rename the '
                f'camera with letters, digits, _ and - only, and not "{NO_CAMERA}".'
            )
        numbers = list_lens_numbers(camera.intrinsics, WRITTEN[:1], TITLE, name)
        pose = np.asarray(camera.cam_from_world)
        intrinsic[f"K_{name}"] = np.array(matrix_of_numbers(numbers))
        intrinsic[f"dist_{name}"] = np.array([numbers.coefficients])
        intrinsic[f"H_{name}"] = camera.image_size_px[1]
        intrinsic[f"W_{name}"] = camera.image_size_px[0]
        extrinsic[f"R_{name}"] = rotation_vector(pose[:, :3])[:, None]
        extrinsic[f"Rot_{name}"] = pose[:, :3]
        extrinsic[f"T_{name}"] = pose[:, 3:] / unit_mm
    with atomic_folder(path) as folder:
        write_storage(intrinsic, folder / INTRINSIC)
        write_storage(extrinsic, folder / EXTRINSIC)


def read_easymocap(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the cameras of intri.yml and their poses in extri.yml."""
    for file in (INTRINSIC, EXTRINSIC):
        if not (path / file).is_file():
            raise InputError(f"{path} holds no {file}: give a folder of EasyMocap's two files.")
    intrinsic, extrinsic = (_by_camera(path / file) for file in (INTRINSIC, EXTRINSIC))
    cameras = {}
    for name, block in intrinsic.items():
        if name not in extrinsic:
            raise InputError(
                f'{path / EXTRINSIC} does not name "{name}": calibrate its pose, or remove it from '
                f"the names in {INTRINSIC}."
            )
        for key in ("H", "W"):
            if not block.values.get(key):
                raise InputError(
                    f"{block.file} has no {key}_{name}: add H_{name} and W_{name}, the height and "
                    "the width of the pictures in pixels."
                )
        size = Block({"size": [block.number("W"), block.number("H")]}, block.file, name)
        distortion = "dist" if "dist" in block.values else "D"
        where = f'{block.file}: camera "{name}"'
        lens = read_opencv_lens(block, "K", distortion, size.image_size_px("size"), "", where)
        cameras[name] = Camera(lens, Pose(_pose(extrinsic[name], unit_mm)))
    return Rig(cameras)


def _by_camera(path: Path) -> dict[str, Block]:
    """Read a file as one `Block` for each camera; "K_left" becomes the key "K" of "left"."""
    document = read_storage(path)
    listed = document.values.get("names")
    if not isinstance(listed, list) or not listed:
        raise document.error("names", "must be the list of the cameras: add it.")
    # FileStorage reads 1 as a number where it is not in quotes.
    names = [f"{name:g}" if isinstance(name, float) else str(name) for name in listed]
    values: dict[str, dict[str, Any]] = {name: {} for name in names if name != NO_CAMERA}
    others = {}
    for key, value in document.values.items():
        ends = [name for name in values if key.endswith(f"_{name}")]
        if ends:
            name = max(ends, key=len)
            values[name][key.removesuffix(f"_{name}")] = value
        else:
            others[key] = value
    KEYS.take(Block(others, document.file, ""))
    return {name: KEYS.take(Block(each, document.file, name)) for name, each in values.items()}


def _pose(block: Block, unit_mm: float) -> np.ndarray:
    vector, translation = flat_numbers(block, "R"), flat_numbers(block, "T")
    if vector.size != 3 or translation.size != 3:
        raise block.error("R", "and T must have three numbers: correct them.")
    rotation = rotation_of_vector(vector)
    if "Rot" in block.values:
        stated = block.numbers("Rot", (3, 3))
        if np.abs(stated - rotation).max() > _SAME:
            raise block.error("Rot", "is another rotation than R: remove the wrong one.")
    return motion(rotation, translation * unit_mm, f'{block.file}: "{block.place}.R"')


easymocap = Format(
    name="easymocap",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    place="folder",
    unit_mm=METRE_MM,
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_easymocap,
    read=read_easymocap,
    keys={"the keys of a camera": KEYS},
)
