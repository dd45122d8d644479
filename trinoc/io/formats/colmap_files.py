"""Text and binary files of COLMAP models. Source: https://colmap.github.io/format.html."""

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import read_bytes, read_text
from trinoc.io.formats.motions import (
    chain_motions,
    inverse,
    motion,
    quaternion_wxyz,
    rotation_of_quaternion as rotation_of,
)
from trinoc.io.formats.text_files import MOST_BYTES_OF_MODEL


class ColmapCamera(NamedTuple):
    """A COLMAP camera: a lens with image size.

    Attributes
    ----------
    model : str
        Name of the lens model, such as "OPENCV".
    size : (width, height)
        Size of the images in px.
    parameters : list of float
        Parameters in the order of the model.
    """

    model: str
    size: tuple[int, int]
    parameters: list[float]


class ColmapImage(NamedTuple):
    """A COLMAP image: the pose of one camera.

    Attributes
    ----------
    number : int
        Id of the image.
    wxyz : list of float
        Quaternion (w, x, y, z) of cam_from_world.
    translation : list of float
        Translation of cam_from_world, in the unit of the file.
    camera : int
        Id of the `ColmapCamera`.
    name : str
        File name of the image.
    """

    number: int
    wxyz: list[float]
    translation: list[float]
    camera: int
    name: str


class ColmapRecords(NamedTuple):
    """Content of a COLMAP model: cameras by id, and images in the order of the file."""

    cameras: dict[int, ColmapCamera]
    images: list[ColmapImage]

    def sensor_poses(self) -> list[tuple[int, list[float]]]:
        """Poses of all images but the first, relative to the first: list of (camera id, pose).

        A pose is camera_from_first_camera: quaternion (w, x, y, z), then translation.
        """
        poses = [
            motion(rotation_of(np.array(image.wxyz), "a pose"), np.array(image.translation), "it")
            for image in self.images
        ]
        sensor_poses = []
        for image, pose in zip(self.images[1:], poses[1:], strict=True):
            step = chain_motions(pose, inverse(poses[0]))
            numbers = [*quaternion_wxyz(step[:, :3]).tolist(), *step[:, 3].tolist()]
            sensor_poses.append((image.camera, numbers))
        return sensor_poses


def text_files(records: ColmapRecords) -> dict[str, str]:
    """Content of the five text files of a COLMAP model, keyed by file name."""
    cameras = [
        f"{number} {model} {width} {height} {_join_numbers(parameters)}"
        for number, (model, (width, height), parameters) in records.cameras.items()
    ]
    images = [
        f"{image.number} {_join_numbers([*image.wxyz, *image.translation])} {image.camera} "
        f"{image.name}\n"
        for image in records.images
    ]
    first = records.images[0]
    sensors = [
        f"CAMERA {camera} 1 {_join_numbers(pose)}" for camera, pose in records.sensor_poses()
    ]
    rig = ["1", str(len(records.images)), f"CAMERA {first.camera}", *sensors]
    data = [f"CAMERA {image.camera} {image.number}" for image in records.images]
    frame = ["1 1", _join_numbers([*first.wxyz, *first.translation]), str(len(data)), *data]
    return {
        "cameras.txt": _file("CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", cameras),
        "images.txt": _file(
            "IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then a line of points", images
        ),
        "points3D.txt": _file("POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[]", []),
        "rigs.txt": _file(
            "RIG_ID, NUM_SENSORS, REF_SENSOR_TYPE, REF_SENSOR_ID, SENSORS[] as (SENSOR_TYPE, "
            "SENSOR_ID, HAS_POSE, [QW, QX, QY, QZ, TX, TY, TZ])",
            [" ".join(rig)],
        ),
        "frames.txt": _file(
            "FRAME_ID, RIG_ID, RIG_FROM_WORLD[QW, QX, QY, QZ, TX, TY, TZ], NUM_DATA_IDS, "
            "DATA_IDS[] as (SENSOR_TYPE, SENSOR_ID, DATA_ID)",
            [" ".join(frame)],
        ),
    }


def text_records(folder: Path) -> ColmapRecords:
    """Read cameras and images from the text files of a COLMAP model.

    Raise `InputError`, which names file and line, for a damaged line.
    """
    cameras: dict[int, ColmapCamera] = {}
    for where, fields in _lines(folder / "cameras.txt"):
        try:
            number, size = int(fields[0]), (int(fields[2]), int(fields[3]))
            camera = ColmapCamera(fields[1], size, [float(word) for word in fields[4:]])
        except (ValueError, IndexError) as error:
            raise InputError(f"{where} is not a camera of COLMAP: correct this line.") from error
        if number in cameras:
            raise InputError(f"{where} repeats the camera {number}: remove one of the two.")
        cameras[number] = camera
    images: list[ColmapImage] = []
    # Below each image stands a line of its points, which programs leave out where there are none.
    may_be_points = False
    for where, fields in _lines(folder / "images.txt", keep_empty=True):
        if may_be_points and _are_points(fields):
            may_be_points = False
            continue
        if not fields:
            continue
        try:
            numbers = [float(word) for word in fields[1:8]]
            number, camera = int(fields[0]), int(fields[8])
            # Names of files may have blanks.
            name = " ".join([fields[9], *fields[10:]])
            images.append(ColmapImage(number, numbers[:4], numbers[4:], camera, name))
        except (ValueError, IndexError) as error:
            raise InputError(f"{where} is not an image of COLMAP: correct this line.") from error
        may_be_points = True
    return ColmapRecords(cameras, images)


def _are_points(fields: list[str]) -> bool:
    """True if the words of a line are image points: x, y and an id for each point.

    Otherwise the line describes an image, which has nine numbers and a name. A name with blanks is
    several words.
    """
    try:
        return len(fields) % 3 == 0 and all(map(math.isfinite, map(float, fields)))
    except ValueError:
        return False


def _lines(file: Path, *, keep_empty: bool = False) -> Iterator[tuple[str, list[str]]]:
    for number, line in enumerate(read_text(file, MOST_BYTES_OF_MODEL).splitlines(), 1):
        if not line.lstrip().startswith("#") and (keep_empty or line.strip()):
            yield f"{file}, line {number},", line.split()


def _file(what: str, lines: list[str]) -> str:
    return f"# {what}\n" + "".join(f"{line}\n" for line in lines)


def _join_numbers(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))


# (number of the model in the file, how many numbers it has).
MODELS = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8),
    "FULL_OPENCV": (6, 12),
    "FOV": (7, 5),
    "SIMPLE_RADIAL_FISHEYE": (8, 4),
    "RADIAL_FISHEYE": (9, 5),
    "THIN_PRISM_FISHEYE": (10, 12),
}
_CAMERA_SENSOR = 0
_POINT_2D = struct.calcsize("<ddQ")


def binary_files(records: ColmapRecords) -> dict[str, bytes]:
    """Content of the five binary files of a COLMAP model, keyed by file name."""
    cameras = struct.pack("<Q", len(records.cameras))
    for number, (model, size, parameters) in records.cameras.items():
        cameras += struct.pack("<IiQQ", number, MODELS[model][0], *size)
        cameras += struct.pack(f"<{len(parameters)}d", *parameters)
    images = struct.pack("<Q", len(records.images))
    for image in records.images:
        images += struct.pack("<I7dI", image.number, *image.wxyz, *image.translation, image.camera)
        images += image.name.encode("utf-8") + struct.pack("<xQ", 0)
    first, count = records.images[0], len(records.images)
    rigs = struct.pack("<QIIiI", 1, 1, count, _CAMERA_SENSOR, first.camera)
    for camera, pose in records.sensor_poses():
        rigs += struct.pack("<iIB7d", _CAMERA_SENSOR, camera, 1, *pose)
    frames = struct.pack("<QII7dI", 1, 1, 1, *first.wxyz, *first.translation, count)
    for image in records.images:
        frames += struct.pack("<iIQ", _CAMERA_SENSOR, image.camera, image.number)
    return {
        "cameras.bin": cameras,
        "images.bin": images,
        "points3D.bin": struct.pack("<Q", 0),
        "rigs.bin": rigs,
        "frames.bin": frames,
    }


def binary_records(folder: Path) -> ColmapRecords:
    """Read cameras and images from the binary files of a COLMAP model.

    Raise `InputError` for a file that is too short or damaged.
    """
    cameras: dict[int, ColmapCamera] = {}
    reader = _Reader(folder / "cameras.bin")
    names = {number: (name, count) for name, (number, count) in MODELS.items()}
    for _ in range(reader.take("<Q")[0]):
        number, model, width, height = reader.take("<IiQQ")
        if model not in names or number in cameras:
            raise reader.damage_error(
                f"camera {number} occurs twice, or has the unknown model {model}"
            )
        name, count = names[model]
        cameras[number] = ColmapCamera(name, (width, height), list(reader.take(f"<{count}d")))
    images = []
    reader = _Reader(folder / "images.bin")
    for _ in range(reader.take("<Q")[0]):
        number, *pose, camera = reader.take("<I7dI")
        name = reader.text()
        reader.skip(reader.take("<Q")[0] * _POINT_2D)
        images.append(ColmapImage(number, pose[:4], pose[4:], camera, name))
    return ColmapRecords(cameras, images)


class _Reader:
    """The content of a binary file with a read position, which starts at the first byte."""

    def __init__(self, file: Path) -> None:
        self.file, self.content, self.place = file, read_bytes(file, MOST_BYTES_OF_MODEL), 0

    def take(self, layout: str) -> tuple:
        """Read numbers in a layout of `struct` and advance the position."""
        start = self.place
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.content, start)

    def skip(self, size: int) -> None:
        """Advance the position by `size` bytes."""
        if self.place + size > len(self.content):
            raise self.damage_error("the file ends too early")
        self.place += size

    def text(self) -> str:
        """Read a UTF-8 string that ends with a zero byte, and advance the position."""
        end = self.content.find(b"\0", self.place)
        if end < 0:
            raise self.damage_error("a name does not end")
        try:
            text = self.content[self.place : end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise self.damage_error("a name is not valid text") from error
        self.place = end + 1
        return text

    def damage_error(self, why: str) -> InputError:
        """Return the `InputError` for a damaged file; `why` is the reason."""
        return InputError(
            f"{self.file} is not a file of COLMAP, or is damaged ({why}): write the file again."
        )
