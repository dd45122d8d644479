"""ROS `camera_info` YAML, as `camera_calibration` writes and `camera_info_manager` reads it.

A camera_info has no pose. A rig is a folder: NAME.yaml for each camera, and its poses in
`tf_static.yaml`. The rectification is the identity and P is [K 0]: three cameras have no common
rectified plane.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import write_text
from trinoc.io.formats.format import COVARIANCE, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.lens_rows import (
    LensNumbers,
    LensRow,
    list_lens_numbers,
    list_lenses,
    make_lens,
)
from trinoc.io.formats.text_files import atomic_folder, read_yaml, yaml_text
from trinoc.io.formats.tf_static import METRE_MM, read_tf, write_tf
from trinoc.io.json_document import Block

TITLE = "ROS camera_info"
POSES = "tf_static.yaml"
_PLUMB_BOB = ("k1", "k2", "p1", "p2", "k3")
_RATIONAL = (*_PLUMB_BOB, "k4", "k5", "k6")
ROWS = (
    LensRow("plumb_bob", "brown_conrady", _PLUMB_BOB),
    LensRow("rational_polynomial", "brown_conrady", _RATIONAL),
    LensRow("rational_polynomial", "rational", _RATIONAL),
    LensRow("rational_polynomial", "thin_prism", (*_RATIONAL, "s1", "s2", "s3", "s4")),
    LensRow("equidistant", "kannala_brandt", ("k1", "k2", "k3", "k4")),
)


def write_ros(value: Rig | Intrinsics, path: Path, unit_mm: float) -> None:
    """Write a lens as a file, or a rig as a folder."""
    if isinstance(value, Intrinsics):
        write_text(path, _text(value, "camera"))
        return
    for name in value:
        expect_ros_name(name)
    texts = {name: _text(lens, name) for name, lens in list_lenses(value).items()}
    with atomic_folder(path) as folder:
        for name, text in texts.items():
            write_text(folder / f"{name}.yaml", text)
        write_tf(value, folder / POSES, METRE_MM)


def read_ros(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig | Intrinsics:
    """The lens of a file, or the rig of a folder with `tf_static.yaml`."""
    if not path.is_dir():
        return _lens(path)
    files = sorted(file for file in path.glob("*.yaml") if file.name != POSES)
    if not files or not (path / POSES).is_file():
        raise InputError(
            f"{path} must hold a camera_info for each camera and their poses in {POSES}: give one "
            "camera_info file to read a lens alone."
        )
    return read_tf(path / POSES, METRE_MM, {file.stem: _lens(file) for file in files})


def expect_ros_name(name: str) -> None:
    """Raise InputError for what ROS does not take as a name."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
        raise InputError(
            f'The camera "{name}" has no name that ROS takes: rename it with letters, digits and _.'
        )


def _text(lens: Intrinsics, camera: str) -> str:
    numbers = list_lens_numbers(lens, ROWS, TITLE, camera)
    (fx, fy), (cx, cy) = numbers.focal_px, numbers.centre_px
    matrix = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    document = {
        "image_width": lens.image_size_px[0],
        "image_height": lens.image_size_px[1],
        "camera_name": camera,
        "camera_matrix": _matrix(3, 3, matrix),
        "distortion_model": numbers.called,
        "distortion_coefficients": _matrix(1, len(numbers.coefficients), numbers.coefficients),
        "rectification_matrix": _matrix(3, 3, np.eye(3).ravel().tolist()),
        "projection_matrix": _matrix(
            3, 4, [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
        ),
    }
    return yaml_text(document)


def _matrix(rows: int, columns: int, data: list[float]) -> dict[str, Any]:
    return {"rows": rows, "cols": columns, "data": data}


def _lens(path: Path) -> Intrinsics:
    """From a calibration file, or from a message as `ros2 topic echo` prints it."""
    document = read_yaml(path)
    if "camera_matrix" in document.values:
        size = [document.number("image_width"), document.number("image_height")]
        matrix = document.block("camera_matrix").numbers("data", (9,))
        coefficients = document.block("distortion_coefficients").numbers("data", (None,))
    else:
        keys = ("k", "d") if "k" in document.values else ("K", "D")
        size = [document.number("width"), document.number("height")]
        matrix, coefficients = document.numbers(keys[0], (9,)), document.numbers(keys[1], (None,))
    (fx, skew, cx), (lower, fy, cy), last = matrix.reshape(3, 3).tolist()
    if skew or lower or last != [0, 0, 1]:
        raise document.error("camera_matrix", "must be fx 0 cx, 0 fy cy, 0 0 1: correct it.")
    numbers = LensNumbers(
        document.text("distortion_model"), (fx, fy), (cx, cy), 0.0, coefficients.tolist()
    )
    size_px = Block({"size": size}, document.file, "").image_size_px("size")
    return make_lens(numbers, size_px, ROWS, str(path))


ros = Format(
    name="ros",
    title=TITLE,
    holds=("rig", "lens"),
    reads=("rig", "lens"),
    place="file or folder",
    endings=(".yaml", ".yml"),
    unit_mm=METRE_MM,
    unit_is_fixed=True,
    frames="pixel (0, 0) is the centre of the top-left pixel; optical frames: x right, y down, "
    "z forward",
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_ros,
    read=read_ros,
)
