"""COLMAP models: a folder with cameras, images, points3D, and the rigs and frames of COLMAP 4.

Every camera of a rig becomes a COLMAP camera with one image, named after the camera. All images
belong to one rig in one frame. COLMAP's pixel origin is the corner of the top-left pixel, so that
principal points differ by half a pixel. Points are not written, because COLMAP has no lines. Text
and binary models are read, with the poses of the images.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.io.atomic import atomic_write
from trinoc.io.formats.colmap_files import (
    ColmapCamera,
    ColmapImage,
    ColmapRecords,
    binary_files,
    binary_records,
    text_files,
    text_records,
)
from trinoc.io.formats.format import COVARIANCE, PIXEL_PITCH, Format, Lenses
from trinoc.io.formats.lens_rows import LensNumbers, LensRow, list_lens_numbers, make_lens
from trinoc.io.formats.motions import motion, quaternion_wxyz, rotation_of_quaternion
from trinoc.io.formats.text_files import atomic_folder

TITLE = "COLMAP"
HALF_PX = 0.5
_OPENCV = ("k1", "k2", "p1", "p2")
ROWS = (
    LensRow("PINHOLE", "none", ()),
    LensRow("OPENCV", "brown_conrady", _OPENCV),
    LensRow("FULL_OPENCV", "brown_conrady", (*_OPENCV, "k3", "k4", "k5", "k6")),
    LensRow("FULL_OPENCV", "rational", (*_OPENCV, "k3", "k4", "k5", "k6")),
    LensRow("OPENCV_FISHEYE", "kannala_brandt", ("k1", "k2", "k3", "k4")),
    LensRow("SIMPLE_PINHOLE", "none", ()),
    LensRow("SIMPLE_RADIAL", "brown_conrady", ("k1",)),
    LensRow("RADIAL", "brown_conrady", ("k1", "k2")),
)
# Models with one focal length for both directions.
SQUARE = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")


def write_binary(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the rig as a COLMAP model in binary files into the folder `path`.

    Translations are in units of `unit_mm`.
    """
    _write(path, binary_files(_records(rig, unit_mm)))


def write_text_model(rig: Rig, path: Path, unit_mm: float) -> None:
    """Write the rig as a COLMAP model in text files into the folder `path`.

    Translations are in units of `unit_mm`. Raise `InputError` for a camera name that contains a
    blank.
    """
    for name in rig:
        if any(letter.isspace() for letter in name):
            raise InputError(
                f'The name of the camera "{name}" contains a blank, which separates values in '
                "COLMAP's text files: rename the camera, or write the binary files (--to colmap)."
            )
    files = text_files(_records(rig, unit_mm))
    _write(path, {name: text.encode("utf-8") for name, text in files.items()})


def read_colmap(path: Path, unit_mm: float, lenses: Lenses | None) -> Rig:
    """Read the rig of a COLMAP model in a folder. Binary files are preferred to text files.

    Each image of the model becomes a camera of the rig.
    """
    if (path / "cameras.bin").is_file():
        records = binary_records(path)
    elif (path / "cameras.txt").is_file():
        records = text_records(path)
    else:
        raise InputError(
            f"{path} has neither cameras.bin nor cameras.txt: give the folder of a COLMAP model."
        )
    read = {number: _lens(camera, str(path)) for number, camera in records.cameras.items()}
    cameras: dict[str, Camera] = {}
    for image in records.images:
        where = f'{path}: the image "{image.name}"'
        if image.name in cameras:
            raise InputError(f"{where} occurs twice: keep one of the two.")
        if image.camera not in read:
            raise InputError(
                f"{where} belongs to camera {image.camera}, which is missing: add this camera."
            )
        if not np.isfinite([*image.wxyz, *image.translation]).all():
            raise InputError(f"{where} has a pose that is not finite: remove the image.")
        rotation = rotation_of_quaternion(np.array(image.wxyz), where)
        pose = motion(rotation, np.array(image.translation) * unit_mm, where)
        cameras[image.name] = Camera(read[image.camera], Pose(pose))
    if not cameras:
        raise InputError(f"{path} holds no image with a pose: give a model with images.")
    return Rig(cameras)


def _records(rig: Rig, unit_mm: float) -> ColmapRecords:
    cameras, images = {}, []
    for number, (name, camera) in enumerate(rig.items(), 1):
        numbers = list_lens_numbers(camera.intrinsics, ROWS, TITLE, name, origin_px=HALF_PX)
        parameters = [*numbers.focal_px, *numbers.centre_px, *numbers.coefficients]
        cameras[number] = ColmapCamera(numbers.called, camera.image_size_px, parameters)
        pose = np.asarray(camera.cam_from_world)
        wxyz, translation = quaternion_wxyz(pose[:, :3]), pose[:, 3] / unit_mm
        images.append(ColmapImage(number, wxyz.tolist(), translation.tolist(), number, name))
    return ColmapRecords(cameras, images)


def _lens(camera: ColmapCamera, where: str) -> Intrinsics:
    parameters = [float(value) for value in camera.parameters]
    if not np.isfinite(parameters).all():
        raise InputError(f"{where} has a camera with numbers that are not finite: correct it.")
    focals = 1 if camera.model in SQUARE else 2
    rows = [row for row in ROWS if row.called == camera.model]
    if rows and len(parameters) != focals + 2 + len(rows[0].coefficients):
        raise InputError(
            f"{where} has a {camera.model} camera with {len(parameters)} numbers: correct it."
        )
    if min(camera.size) < 1:
        raise InputError(f"{where} has a camera without pixels: correct its size.")
    focal, others = (parameters[:focals] * 2)[:2], parameters[focals:]
    if len(others) < 2:
        focal, others = [1.0, 1.0], [0.0, 0.0]  # of a model that is not known, and refused below
    numbers = LensNumbers(
        camera.model, (focal[0], focal[1]), (others[0], others[1]), 0.0, others[2:]
    )
    return make_lens(numbers, camera.size, ROWS, where, origin_px=HALF_PX)


def _write(path: Path, files: dict[str, bytes]) -> None:
    with atomic_folder(path) as folder:
        for name, content in files.items():
            with atomic_write(folder / name) as file:
                file.write(content)


colmap = Format(
    name="colmap",
    title=TITLE,
    holds=("rig",),
    reads=("rig",),
    place="folder",
    frames="pixel (0, 0) is the corner of the top-left pixel, (0.5, 0.5) its centre; x right, "
    "y down, z forward",
    loses=(COVARIANCE, PIXEL_PITCH),
    write=write_binary,
    read=read_colmap,
)
colmap_text = replace(colmap, name="colmap-text", title="COLMAP (text)", write=write_text_model)
