"""Reading of images at the bit depth of the file: one image, one for each view, or by shot.

Sources of the end marks of files: the PNG specification; T.81 for JPEG.
"""

import contextlib
import glob
import hashlib
import io
import itertools
import os
import shlex
import struct
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from trinoc.errors import InputError
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.io.atomic import atomic_write, read_bytes
from trinoc.io.picture_tags import as_stored, has_white_as_zero, warn_of_orientation

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_JPEG, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
# Cameras may add something behind the end.
_TAIL = 4096


def is_whole_picture(path: str | os.PathLike[str]) -> bool:
    """True if a PNG or JPEG file contains its end mark, or another file is not empty.

    Raise OSError if the file cannot be read.
    """
    with Path(path).open("rb") as file:
        start = file.read(8)
        file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
        return bool(start) and ends_as_it_should(start, file.read())


def ends_as_it_should(start: bytes, tail: bytes | None = None) -> bool:
    """True if the content of a PNG or JPEG file contains its end mark; True for other formats.

    `start` is the content or its beginning. `tail` is the end of the content if `start` is not all.
    """
    end = start if tail is None else tail
    if start.startswith(_PNG):
        return _PNG_END in end
    return _JPEG_END in end if start.startswith(_JPEG) else True


# What Pillow reads, and so the most that a file may announce: no sensor has more.
MOST_PIXELS = 178_956_970
# DEFLATE makes no more of a byte (RFC 1951: 258 bytes by two codes of one bit each).
_MOST_INFLATED = 1032
# Signature and first chunk.
_PNG_HEADER_BYTES = 33
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def is_complete(content: bytes) -> bool:
    """True if the content of a PNG file is long enough for the image size in its header.

    True for other formats. The test protects OpenCV, which reserves memory for the lengths that a
    file states.
    """
    if not content.startswith(b"\x89PNG\r\n\x1a\n"):
        return True
    if len(content) < _PNG_HEADER_BYTES:
        return False
    width, height, depth, colours = struct.unpack_from(">IIBB", content, 16)
    unpacked = width * height * depth * _PNG_CHANNELS.get(colours, 1) // 8
    offset = 8
    while offset + 12 <= len(content) and content[offset + 4 : offset + 8] != b"IEND":
        offset += 12 + struct.unpack_from(">I", content, offset)[0]
    return offset + 12 <= len(content) and unpacked <= _MOST_INFLATED * len(content)


def size_px(content: bytes) -> tuple[int, int] | None:
    """Image size (width, height) from the header; None if Pillow cannot read the header.

    Raise Image.DecompressionBombError for more than MOST_PIXELS pixels.
    """
    with warnings.catch_warnings():
        # Of half as many: such cameras there are.
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        try:
            with Image.open(io.BytesIO(content)) as picture:
                return picture.size
        except Image.DecompressionBombError:
            raise
        except Exception:  # a damaged header can be anything to its parser
            return None


def _count_pictures(content: bytes) -> int:
    """Number of images of equal size in a file, such as a stack or an animation.

    Previews, which cameras add, are not counted.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(io.BytesIO(content)) as picture:
                count, size = getattr(picture, "n_frames", 1), picture.size
                if count == 1 or picture.format == "MPO":
                    return 1
                picture.seek(1)
                return count if picture.size == size else 1
        except Exception:  # as in size_px
            return 1


IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".webp")
VIDEO_SUFFIXES = (
    *(".avi", ".mp4", ".m4v", ".mov", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv", ".mts", ".m2ts"),
    *(".3gp", ".ogv"),
)
# Uncompressed, colours of 16 bit.
MOST_BYTES = 7 * MOST_PIXELS


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """Read an image file with its original bit depth and pixel order.

    Parameters
    ----------
    path : path
        Image file, such as PNG, TIFF or JPEG.

    Returns
    -------
    (h, w) or (h, w, 3)
        Grey levels, or red, green and blue, in the number type of the file.

    Raises
    ------
    InputError
        If the file is not a readable image, or if only its transparency has content.

    Notes
    -----
    Orientation tags are not applied, because a lens calibration belongs to the pixels of the
    sensor. One warning in each folder names the first image with such a tag. Grey levels of a TIFF
    in which zero means white are inverted. Transparency is dropped.
    """
    file = Path(path)
    return _decode(file, _content(file))


def read_size_px(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the size (width, height) of an image without decoding its pixels.

    Raise `InputError` if the file is not an image.
    """
    file = Path(path)
    size = size_px(_content(file))
    if size is None:
        raise _unreadable(file)
    return size


def read_views(paths: Mapping[str, str | os.PathLike[str]]) -> dict[str, np.ndarray]:
    """Read the image of each view.

    Raise `InputError` for an unreadable file, and if two views have equal images.
    """
    images: dict[str, np.ndarray] = {}
    view_of: dict[bytes, str] = {}
    for view, path in paths.items():
        file = Path(path)
        image = _decode(file, _content(file))
        other = view_of.setdefault(picture_digest(image), view)
        if other != view:
            raise InputError(
                f'Views "{other}" and "{view}" are the same picture ({file}): give the picture '
                "that each camera took."
            )
        images[view] = image
    return images


def write_picture(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write an image, (h, w) grey levels or (h, w, 3) red, green, blue, to a PNG file.

    The file appears complete or not at all. Raise `InputError` if it cannot be written.
    """
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, content = cv2.imencode(".png", ordered)
    with atomic_write(path) as file:
        file.write(content.tobytes())


@contextlib.contextmanager
def silent_opencv() -> Iterator[None]:
    """Context manager in which OpenCV prints nothing to stderr about damaged files."""
    if hasattr(cv2.utils, "logging"):
        get_level, set_level = cv2.utils.logging.getLogLevel, cv2.utils.logging.setLogLevel
    else:  # before OpenCV 4.13
        get_level, set_level = cv2.getLogLevel, cv2.setLogLevel  # pyright: ignore
    level = get_level()
    # numerical: the level of silence, in all versions.
    set_level(0)
    try:
        yield
    finally:
        set_level(level)


def picture_digest(image: np.ndarray) -> bytes:
    """SHA-256 digest of an image; equal for images with equal pixels, shape and type."""
    pixels = hashlib.sha256(repr((image.shape, image.dtype)).encode())
    pixels.update(np.ascontiguousarray(image).data)
    return pixels.digest()


def _content(file: Path) -> bytes:
    if os.path.isdir(file):  # False for names that are too long
        image_names = sorted(p.name for p in file.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not image_names:
            raise InputError(f"{file} is a folder without pictures: give a picture file.")
        raise InputError(
            f"{file} is a folder: give one picture in it, such as {file / image_names[0]}."
        )
    content = read_bytes(file, MOST_BYTES)
    if not content:
        raise InputError(f"{file} is empty: copy the picture again from its source.")
    warn_of_orientation(file, content)
    return as_stored(content)


def _unreadable(file: Path) -> InputError:
    refuse_videos([file])
    return InputError(f"{file} is not a readable picture: give a PNG, TIFF or JPEG file.")


def refuse_videos(files: Iterable[Path]) -> None:
    """Raise `InputError` for the first video among `files`.

    The message explains how to convert the video to images.
    """
    for file in files:
        if file.suffix.lower() in VIDEO_SUFFIXES:
            raise InputError(
                f"{file} is a video: write its frames by `trinoc export {shlex.quote(str(file))} "
                "--from video -o frames`, or give the video to `trinoc watch` if it shows a moving "
                "board."
            )


def _decode(file: Path, content: bytes) -> np.ndarray:
    try:
        size = size_px(content)
    except Image.DecompressionBombError as error:
        raise InputError(
            f"{file} announces more pixels than any camera has: give a picture of at most "
            f"{MOST_PIXELS / 1e6:.0f} megapixels."
        ) from error
    if not is_complete(content):
        raise InputError(
            f"{file} is a PNG file that is incomplete or states a wrong size: copy the picture "
            "again from its source."
        )
    if size is None or min(size) < 1:
        raise _unreadable(file)
    count = _count_pictures(content)
    if count > 1:
        raise InputError(f"{file} contains {count} pictures: save one of them to a separate file.")
    if not ends_as_it_should(content):
        raise InputError(f"{file} is incomplete: copy the picture again.")
    try:
        with silent_opencv():
            image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    except (cv2.error, MemoryError):
        image = None
    if image is None:
        raise _unreadable(file)
    if image.dtype == np.uint16 and has_white_as_zero(content):
        # OpenCV does so for 8 bit alone.
        image = np.iinfo(np.uint16).max - image
    if image.ndim == 2:
        return image
    if image.shape[2] == 4:
        if np.ptp(image[..., 3]) and not np.ptp(image[..., :3], axis=(0, 1)).any():
            raise InputError(
                f"{file} has a drawing in its transparency only, and one colour everywhere: save "
                "the picture without transparency, on white."
            )
        return cv2.cvtColor(image, cv2.COLOR_BGRA2RGB)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def expect_inside(name: str, segments: Segments, rig: Rig, file: str | os.PathLike[str]) -> None:
    """Raise `InputError` for a segment that is farther outside the image than one image size.

    `name` is the view, and `file` is named in the message.
    """
    size = np.array(rig[name].image_size_px)
    ends = np.asarray(segments.endpoints_px)
    outside = np.flatnonzero(((ends < -size) | (ends > 2 * size)).any(axis=(1, 2)))
    if len(outside):
        raise InputError(
            f'{file}: segment {outside[0]} lies far outside the pictures of "{name}", which are '
            f"{size[0]} x {size[1]} px: give ends in pixels of that camera."
        )


def expect_size(name: str, image: np.ndarray, rig: Rig) -> None:
    """Raise `InputError` if the size of an image differs from that of camera `name` in the rig."""
    size = (image.shape[1], image.shape[0])
    if size != rig[name].image_size_px:
        raise InputError(
            f'The picture of "{name}" is {size[0]} x {size[1]} px, but the rig was calibrated for '
            f"{rig[name].image_size_px[0]} x {rig[name].image_size_px[1]} px: give a picture of "
            "that size."
        )


Shots = dict[str, dict[str, Callable[[], np.ndarray]]]


def load_shots(paths: Mapping[str, str | os.PathLike[str]]) -> Shots:
    """List the images of each camera, sorted by shot, without reading them.

    Images of several cameras belong to one shot if their file names agree. The beginning and the
    end that all names of one camera have in common are ignored: left_07.png and right_07.png belong
    to the shot "07".

    Parameters
    ----------
    paths : dict of path
        For each camera: a folder of images, or a pattern such as "shots/left*.png".

    Returns
    -------
    dict of dict of callables
        For each camera and each shot name: a function without arguments that reads the image.

    Raises
    ------
    InputError
        If a path has no image, or two cameras have the same image.
    """
    files = {camera: _files(camera, os.fspath(path)) for camera, path in paths.items()}
    owner: dict[Path, str] = {}
    for camera, camera_files in files.items():
        for file in camera_files:
            other = owner.setdefault(file.resolve(), camera)
            if other != camera:
                raise InputError(
                    f'{file} is a picture of "{other}" and of "{camera}": give each camera its own '
                    "picture."
                )
    names = name_shots(
        {camera: [file.stem for file in camera_files] for camera, camera_files in files.items()}
    )
    return {
        camera: {
            name: partial(read_image, file)
            for name, file in zip(names[camera], camera_files, strict=True)
        }
        for camera, camera_files in files.items()
    }


def _files(camera: str, path: str) -> list[Path]:
    is_folder = os.path.isdir(path)
    entries = sorted(Path(path).iterdir() if is_folder else map(Path, glob.glob(path)))
    if is_folder:
        files = [file for file in entries if file.suffix.lower() in IMAGE_SUFFIXES]
    else:
        files = [file for file in entries if file.is_file()]
        refuse_videos(files)
    if not files:
        refuse_videos(entries)
        if not glob.has_magic(path) and not os.path.exists(path):
            raise InputError(
                f'{path}, the folder of "{camera}", does not exist: give a folder of pictures, or '
                "a pattern such as 'shots/left*.png' in quotes."
            )
        raise InputError(
            f'{path} holds no picture of "{camera}": give a folder of pictures, or a pattern such '
            "as 'shots/left*.png' in quotes."
        )
    return files


def name_shots(stems: Mapping[str, list[str]]) -> Mapping[str, list[str]]:
    """Shot names of the files of each camera; `stems` are the file names without ending.

    If a stem occurs for all cameras, the stems are the shot names. Otherwise the parts that all
    stems of one camera share are removed.
    """
    stem_sets = [set(camera_stems) for camera_stems in stems.values()]
    if len(stems) == 1 or set.intersection(*stem_sets):
        return stems
    return {camera: _without_common(camera_stems) for camera, camera_stems in stems.items()}


def _without_common(stems: list[str]) -> list[str]:
    """Texts without their common beginning and their common end.

    A number is not cut: 10 and 11 keep both digits.
    """
    if len(stems) == 1:
        return ["".join(letter for letter in stems[0] if letter.isdigit()) or stems[0]]
    start = _common_length(stems)
    while start and stems[0][start - 1].isdigit():
        start -= 1
    endings = [stem[start:] for stem in stems]
    end = _common_length([stem[::-1] for stem in endings])
    while end and endings[0][-end].isdigit():
        end -= 1
    differences = [stem[: len(stem) - end] for stem in endings]
    return differences if all(differences) else endings


def _common_length(texts: list[str]) -> int:
    """Length of the longest common beginning of several texts."""
    columns = zip(*texts, strict=False)
    return sum(1 for _ in itertools.takewhile(lambda column: len(set(column)) == 1, columns))
