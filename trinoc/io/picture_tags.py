"""Tags of image files that change the display: orientation, and white as zero.

Orientation tags are not applied, because a lens calibration belongs to the pixels of the sensor.
Decoders of TIFF rotate the pixels by this tag, so it is set to 1 before decoding.

References
----------
Adobe (1992), TIFF Revision 6.0: section 2 for the directory, page 36 for Orientation, page 37 for
PhotometricInterpretation. BigTIFF: its file layout by the maintainers of libtiff.
"""

import io
import logging
import struct
import warnings
from pathlib import Path
from typing import NamedTuple

from PIL import Image

LOGGER = logging.getLogger("trinoc")

_ORIENTATION, _PHOTOMETRIC, _WHITE_IS_ZERO = 274, 262, 0
_SHORT = 3
# Values of the orientation tag that mean something; 1 is "as stored".
_TURNS = range(2, 9)
_PNG = b"\x89PNG\r\n\x1a\n"
# Folders that a warning has named in this process.
_named_folders: set[Path] = set()


class _Directory(NamedTuple):
    """Layout of the first directory of a TIFF file.

    Attributes
    ----------
    order : str
        Byte order as a prefix of `struct` formats, "<" or ">".
    start : int
        Offset of the directory in the file.
    count_format : str
        Format of the number of entries.
    entry_bytes : int
        Size of an entry.
    value_at : int
        Offset of the value in an entry.
    """

    order: str
    start: int
    count_format: str
    entry_bytes: int
    value_at: int


def read_orientation(content: bytes) -> int:
    """Orientation tag of an image file, 1 to 8; 1 if the tag is missing or invalid."""
    tag = _tiff_tag(content, _ORIENTATION) if _directory(content) else _exif_orientation(content)
    return tag if tag is not None and tag in _TURNS else 1


def has_white_as_zero(content: bytes) -> bool:
    """True for a TIFF file in which the level 0 means white."""
    return _tiff_tag(content, _PHOTOMETRIC) == _WHITE_IS_ZERO


def as_stored(content: bytes) -> bytes:
    """Content of an image file, with the orientation tag of a TIFF set to 1 (as stored)."""
    directory, offset = _directory(content), _tiff_value_at(content, _ORIENTATION)
    if directory is None or offset is None or _tiff_tag(content, _ORIENTATION) == 1:
        return content
    return content[:offset] + struct.pack(f"{directory.order}H", 1) + content[offset + 2 :]


def warn_of_orientation(file: Path, content: bytes) -> None:
    """Log a warning if an image has an orientation tag, once for each folder in a process."""
    orientation = read_orientation(content)
    if orientation == 1 or file.parent in _named_folders:
        return
    _named_folders.add(file.parent)
    LOGGER.warning(
        "%s has a tag to rotate or mirror it in viewers (orientation tag %d): trinoc uses the "
        "pixels of the sensor, also for the other pictures of this folder",
        file,
        orientation,
    )


def _exif_orientation(content: bytes) -> int | None:
    """Orientation tag of a JPEG, WebP or PNG file; None if there is no readable tag."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if content.startswith(_PNG):
                exif = Image.Exif()
                exif.load(_png_chunk(content, b"eXIf"))
                return exif.get(_ORIENTATION)
            with Image.open(io.BytesIO(content)) as picture:
                return picture.getexif().get(_ORIENTATION)
        except Exception:  # a damaged header can be anything to its parser
            return None


def _png_chunk(content: bytes, kind: bytes) -> bytes:
    """Data of the first chunk of type `kind` in a PNG file; empty if there is none."""
    offset = len(_PNG)
    while offset + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, offset)
        if content[offset + 4 : offset + 8] == kind:
            return content[offset + 8 : offset + 8 + length]
        offset += 12 + length
    return b""


def _directory(content: bytes) -> _Directory | None:
    """Layout of the first directory of a TIFF file; None for other formats."""
    order = {b"II": "<", b"MM": ">"}.get(content[:2])
    if order is None or len(content) < 16:
        return None
    (version,) = struct.unpack_from(f"{order}H", content, 2)
    if version == 42:
        (start,) = struct.unpack_from(f"{order}I", content, 4)
        return _Directory(order, start, f"{order}H", 12, 8)
    if version == 43:
        (start,) = struct.unpack_from(f"{order}Q", content, 8)
        return _Directory(order, start, f"{order}Q", 20, 12)
    return None


def _tiff_value_at(content: bytes, tag: int) -> int | None:
    """Offset in the file of a tag's 16-bit value, in a TIFF's first image; None if missing."""
    directory = _directory(content)
    if directory is None or directory.start + 8 > len(content):
        return None
    (count,) = struct.unpack_from(directory.count_format, content, directory.start)
    first = directory.start + struct.calcsize(directory.count_format)
    entry_count = min(count, (len(content) - first) // directory.entry_bytes)
    for offset in range(first, first + entry_count * directory.entry_bytes, directory.entry_bytes):
        number, kind = struct.unpack_from(f"{directory.order}HH", content, offset)
        if number == tag:
            return offset + directory.value_at if kind == _SHORT else None
    return None


def _tiff_tag(content: bytes, tag: int) -> int | None:
    """16-bit value of a tag of a TIFF's first image; None if missing."""
    directory, offset = _directory(content), _tiff_value_at(content, tag)
    if directory is None or offset is None:
        return None
    return struct.unpack_from(f"{directory.order}H", content, offset)[0]
