"""TOML files of aniposelib and FreeMoCap, and of Caliscope.

Both have a table for each camera: OpenCV's `matrix` and `distortions`, and `rotation` (rotation
vector) and `translation` of x_cam = R x_world + t. The table of aniposelib is `[cam_0]`, with a
`name`, in the unit of its board. The table of Caliscope is `[cameras.0]`, in metres. Caliscope's
`rotation_count` rotates images for detection and display only. Its lenses belong to the images as
stored.

Source: cameras.py of aniposelib, camera_array.py of Caliscope, calibration_result.py of FreeMoCap.
"""

import datetime
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, METRE_MM, NAMES, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.keys import Keys
from trinoc.io.formats.lens_rows import list_lens_numbers
from trinoc.io.formats.motions import motion, rotation_of_vector, rotation_vector
from trinoc.io.formats.notations import Notation, RefusedError, make_block, parse_file
from trinoc.io.formats.opencv_lens import (
    FISHEYE,
    WRITTEN,
    flat_numbers,
    matrix_of_numbers,
    read_opencv_lens,
)
from trinoc.io.formats.text_files import scalar_or_list
from trinoc.io.json_document import MOST_NESTED, Block

ANIPOSE, CALISCOPE = "aniposelib's TOML", "Caliscope's camera_array.toml"
# Names with dots between, whose time of parsing grows with the square of their number.
_NAME = r"""(?:[\w-]++|"[^"\n]*"|'[^'\n]*')"""
_TOO_DEEP = re.compile(rf"(?<![\w-])(?:{_NAME}[ \t]*\.[ \t]*){{{MOST_NESTED}}}")
KEYS = Keys(
    read=("name", "size", "matrix", "distortions", "rotation", "translation", "fisheye", "ignore"),
    # FreeMoCap computes both from rotation and translation.
    left_out=("rotation_count", "world_orientation", "world_position"),
)


def write_anipose(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the cameras as TOML tables `[cam_0]`, `[cam_1]`, ..., each with the key `name`.

    Translations are in units of `unit_mm`.
    """
    tables = {
        f"cam_{number}": {"name": name, **_to_table(camera, name, ANIPOSE, unit_mm)}
        for number, (name, camera) in enumerate(rig.items())
    }
    _write_toml({**tables, "metadata": {"adjusted": False, "error": 0.0}}, path)


def write_caliscope(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the cameras as TOML tables `[cameras.0]`, `[cameras.1]`, ..., without names.

    Translations are in units of `unit_mm`.
    """
    tables = {
        f"cameras.{number}": {
            "cam_id": number,
            **_to_table(camera, name, CALISCOPE, unit_mm),
            "rotation_count": 0,
        }
        for number, (name, camera) in enumerate(rig.items())
    }
    _write_toml(tables, path)


def read_anipose(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read one camera from each TOML table of the file except `[metadata]`."""
    document = read_toml(path)
    if "cameras" in document.values:
        raise document.error(
            "cameras", "is a key of Caliscope: import the file with the format caliscope."
        )
    tables = {
        key: document.block(key)
        for key, value in document.values.items()
        if key != "metadata" and isinstance(value, dict)
    }
    return _read_cameras(tables, path, unit_mm)


def read_caliscope(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the cameras from the TOML tables under `cameras`, except those with `ignore = true`.

    Files of an earlier version have tables `cam_0`, `cam_1`, ... instead.
    """
    document = read_toml(path)
    if "cameras" in document.values:
        tables = {f"cam_{key}": block for key, block in document.block("cameras").blocks()}
    else:
        keys = [key for key in document.values if re.fullmatch(r"cam_\d+", key)]
        tables = {key: document.block(key) for key in keys}
    used = {name: table for name, table in tables.items() if table.values.get("ignore") is not True}
    return _read_cameras(used, path, unit_mm)


def _to_table(camera: Camera, name: str, title: str, unit_mm: float) -> dict[str, Any]:
    numbers = list_lens_numbers(camera.intrinsics, WRITTEN, title, name)
    pose = np.asarray(camera.cam_from_world)
    return {
        "size": list(camera.image_size_px),
        "matrix": matrix_of_numbers(numbers),
        "distortions": numbers.coefficients,
        "rotation": rotation_vector(pose[:, :3]).tolist(),
        "translation": (pose[:, 3] / unit_mm).tolist(),
        "fisheye": numbers.called == FISHEYE.called,
    }


def _read_cameras(tables: dict[str, Block], path: Path, unit_mm: float) -> Rig:
    if not tables:
        raise InputError(f"{path} has no table of a camera: give a calibration file.")
    cameras: dict[str, Camera] = {}
    for key, table in tables.items():
        block = KEYS.take(table)
        name = block.text("name") if "name" in block.values else key
        if name in cameras:
            raise block.error(
                "name",
                f'is "{name}", the name of an earlier camera: rename one of the two cameras.',
            )
        if "matrix" not in block.values:
            raise block.error(
                "matrix", "is missing: keep only the tables of cameras, and metadata, in the file."
            )
        fisheye = block.values.get("fisheye", False)
        if not isinstance(fisheye, bool):
            raise block.error("fisheye", "must be true or false: correct it.")
        for missing in ("rotation", "translation"):
            if block.values.get(missing, "null") == "null":
                raise block.error(
                    missing, "is missing: calibrate all cameras together, or remove this camera."
                )
        lens = read_opencv_lens(
            block,
            "matrix",
            "distortions",
            block.image_size_px("size"),
            FISHEYE.called if fisheye else "",
            f'{block.file}: "{block.place}"',
        )
        rotation = flat_numbers(block, "rotation")
        # Caliscope wrote a matrix once.
        matrix = rotation.reshape(3, 3) if rotation.size == 9 else None
        if matrix is None and rotation.size != 3:
            raise block.error("rotation", "must be three numbers, axis times angle: correct it.")
        translation = flat_numbers(block, "translation")
        if translation.size != 3:
            raise block.error("translation", "must be three numbers: correct it.")
        pose = motion(
            rotation_of_vector(rotation) if matrix is None else matrix,
            translation * unit_mm,
            f'{block.file}: "{block.place}.rotation"',
        )
        cameras[name] = Camera(lens, Pose(pose))
    return Rig(cameras)


def read_toml(path: Path) -> Block:
    """Read the tables of a TOML file as a `Block`; dates become strings.

    Raise `InputError` if the file is unreadable or not TOML.
    """
    return make_block(parse_file(path, TOML), path)


def _parse_toml(text: str) -> dict[str, Any]:
    if _TOO_DEEP.search(text):
        raise RefusedError(
            f"is nested more than {MOST_NESTED} deep, which is not possible in a valid file: give "
            "another file."
        )
    return _without_dates(tomllib.loads(text))


TOML = Notation("TOML", _parse_toml, (ValueError,))


def _without_dates(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_dates(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_without_dates(item) for item in value]
    return str(value) if isinstance(value, datetime.date | datetime.time) else value


def _write_toml(tables: dict[str, dict[str, Any]], path: Path) -> None:
    texts = []
    for name, table in tables.items():
        lines = (f"{key} = {scalar_or_list(value)}\n" for key, value in table.items())
        texts.append(f"[{name}]\n{''.join(lines)}")
    write_text(path, "\n".join(texts))


anipose = Format(
    name="anipose",
    title=ANIPOSE,
    holds=("rig",),
    reads=("rig",),
    endings=(".toml",),
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_anipose,
    read=read_anipose,
    keys={"a camera": KEYS},
)
caliscope = replace(
    anipose,
    name="caliscope",
    title=CALISCOPE,
    unit_mm=METRE_MM,
    loses=(NAMES, *anipose.loses),
    write=write_caliscope,
    read=read_caliscope,
)
