"""COLMAP's binary files, little-endian and packed, after https://colmap.github.io/format.html."""

import struct
from pathlib import Path

from trinoc.errors import InputError
from trinoc.io.formats.colmap_records import ColmapCamera, ColmapImage, ColmapRecords
from trinoc.io.formats.text_files import MOST_BYTES_OF_MODEL
from trinoc.io.whole_files import read_bytes

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
    """The five files, by name."""
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
    """The cameras and images of a folder. Raises InputError for a file that is cut or damaged."""
    cameras: dict[int, ColmapCamera] = {}
    reader = _Reader(folder / "cameras.bin")
    names = {number: (name, count) for name, (number, count) in MODELS.items()}
    for _ in range(reader.take("<Q")[0]):
        number, model, width, height = reader.take("<IiQQ")
        if model not in names or number in cameras:
            raise reader.damage_error(
                f"camera {number} is there twice, or of the unknown model {model}"
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
    """A file's bytes, from the first to the last."""

    def __init__(self, file: Path) -> None:
        self.file, self.content, self.place = file, read_bytes(file, MOST_BYTES_OF_MODEL), 0

    def take(self, layout: str) -> tuple:
        """The next numbers."""
        start = self.place
        self.skip(struct.calcsize(layout))
        return struct.unpack_from(layout, self.content, start)

    def skip(self, size: int) -> None:
        """Leave the next bytes out."""
        if self.place + size > len(self.content):
            raise self.damage_error("it ends too early")
        self.place += size

    def text(self) -> str:
        """The next text, which ends with a zero."""
        end = self.content.find(b"\0", self.place)
        if end < 0:
            raise self.damage_error("a name does not end")
        try:
            text = self.content[self.place : end].decode("utf-8")
        except UnicodeDecodeError as error:
            raise self.damage_error("a name is no text") from error
        self.place = end + 1
        return text

    def damage_error(self, why: str) -> InputError:
        """The error that says so."""
        return InputError(f"{self.file} is no file of COLMAP, or damaged ({why}): write it again.")
