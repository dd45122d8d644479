"""Pictures from files, at the depth that the camera recorded."""

import hashlib
import io
import os
import struct
import warnings
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from trinoc.errors import InputError
from trinoc.io.atomic import atomic_write
from trinoc.io.whole_files import read_bytes
from trinoc.io.whole_picture import ends_as_it_should

# What Pillow reads, and so the most that a file may announce: no sensor has more.
MOST_PIXELS = 178_956_970
# DEFLATE makes no more of a byte (RFC 1951: 258 bytes by two codes of one bit each).
_MOST_INFLATED = 1032
# Signature and first chunk.
_PNG_HEADER_BYTES = 33
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}


def is_complete(content: bytes) -> bool:
    """Whether a PNG holds the chunks and pixels that it announces; True for other formats.

    OpenCV takes memory for a chunk by the length that stands before it.
    """
    if not content.startswith(b"\x89PNG\r\n\x1a\n"):
        return True
    if len(content) < _PNG_HEADER_BYTES:
        return False
    width, height, depth, colours = struct.unpack_from(">IIBB", content, 16)
    unpacked = width * height * depth * _PNG_CHANNELS.get(colours, 1) // 8
    at = 8
    while at + 12 <= len(content) and content[at + 4 : at + 8] != b"IEND":
        at += 12 + struct.unpack_from(">I", content, at)[0]
    return at + 12 <= len(content) and unpacked <= _MOST_INFLATED * len(content)


def size_px(content: bytes) -> tuple[int, int] | None:
    """(width, height) that a picture announces, None for what Pillow knows no picture in.

    Raises Image.DecompressionBombError for more than MOST_PIXELS.
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


IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".pgm", ".ppm", ".webp")
# Uncompressed, colours of 16 bit.
MOST_BYTES = 7 * MOST_PIXELS


def read_image(path: str | os.PathLike[str]) -> np.ndarray:
    """(h, w) grey levels or (h, w, 3) red, green, blue, in the depth of the file.

    Rotation tags are ignored: pixels stay where the sensor had them, as the calibration of a
    lens demands. Transparency is dropped. Raises InputError for what is not a picture.
    """
    file = Path(path)
    return _decode(file, _content(file))


def read_views(paths: Mapping[str, str | os.PathLike[str]]) -> dict[str, np.ndarray]:
    """The picture of each view. Raises InputError, also where two views share one picture."""
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
    """Write (h, w) grey levels or (h, w, 3) red, green, blue as a PNG, whole or not at all.

    Raises InputError where it cannot be written.
    """
    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, content = cv2.imencode(".png", ordered)
    with atomic_write(path) as file:
        file.write(content.tobytes())


def picture_digest(image: np.ndarray) -> bytes:
    """The same for equal pictures alone."""
    pixels = hashlib.sha256(repr((image.shape, image.dtype)).encode())
    pixels.update(np.ascontiguousarray(image).data)
    return pixels.digest()


def _content(file: Path) -> bytes:
    if file.is_dir():
        inside = sorted(p.name for p in file.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not inside:
            raise InputError(f"{file} is a folder without pictures: give a picture file.")
        raise InputError(f"{file} is a folder: give one picture in it, such as {file / inside[0]}.")
    return read_bytes(file, MOST_BYTES)


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
            f"{file} is a PNG that is cut off or announces more than it holds: copy the picture "
            "again from where it came."
        )
    if size is None or min(size) < 1:
        raise InputError(f"{file} is not a readable picture: give a PNG, TIFF or JPEG file.")
    if not ends_as_it_should(content):
        raise InputError(f"{file} ends before its picture does: copy it again.")
    # OpenCV warns on stderr about broken files; the sentence below says it better.
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        image = (
            cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
            if content
            else None
        )
    except (cv2.error, MemoryError):
        image = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if image is None:
        raise InputError(f"{file} is not a readable picture: give a PNG, TIFF or JPEG file.")
    if image.ndim == 2:
        return image
    if image.shape[2] == 4:
        return cv2.cvtColor(image, cv2.COLOR_BGRA2RGB)
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
