"""COLMAP's text files, after https://colmap.github.io/format.html."""

from collections.abc import Iterator
from pathlib import Path

from trinoc.errors import InputError
from trinoc.io.formats.colmap_records import ColmapCamera, ColmapImage, ColmapRecords
from trinoc.io.formats.text_files import MOST_BYTES_OF_MODEL
from trinoc.io.whole_files import read_text


def text_files(records: ColmapRecords) -> dict[str, str]:
    """The five files, by name."""
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
    """The cameras and images of a folder. Raises InputError, naming file and line."""
    cameras: dict[int, ColmapCamera] = {}
    for where, words in _lines(folder / "cameras.txt"):
        try:
            number, size = int(words[0]), (int(words[2]), int(words[3]))
            camera = ColmapCamera(words[1], size, [float(word) for word in words[4:]])
        except (ValueError, IndexError) as error:
            raise InputError(f"{where} is no camera of COLMAP: correct it.") from error
        if number in cameras:
            raise InputError(f"{where} has the camera {number} again: remove one.")
        cameras[number] = camera
    images, is_image = [], True
    for where, words in _lines(folder / "images.txt", keep_empty=True):
        if not is_image:  # its points
            is_image = True
            continue
        if not words:
            continue
        try:
            numbers = [float(word) for word in words[1:8]]
            number, camera = int(words[0]), int(words[8])
            images.append(ColmapImage(number, numbers[:4], numbers[4:], camera, words[9]))
        except (ValueError, IndexError) as error:
            raise InputError(f"{where} is no image of COLMAP: correct it.") from error
        is_image = False
    return ColmapRecords(cameras, images)


def _lines(file: Path, *, keep_empty: bool = False) -> Iterator[tuple[str, list[str]]]:
    for number, line in enumerate(read_text(file, MOST_BYTES_OF_MODEL).splitlines(), 1):
        if not line.lstrip().startswith("#") and (keep_empty or line.strip()):
            yield f"{file}, line {number},", line.split()


def _file(what: str, lines: list[str]) -> str:
    return f"# {what}\n" + "".join(f"{line}\n" for line in lines)


def _join_numbers(numbers: list[float]) -> str:
    return " ".join(map(repr, numbers))
