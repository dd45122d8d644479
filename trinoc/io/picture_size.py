"""Width and height of a picture by its header alone, before memory is taken for its pixels.

A PNG of one megabyte can announce, and unpack to, gigabytes. Sources: the PNG, JPEG (T.81), TIFF 6,
BMP, Netpbm and WebP specifications.
"""

import re
import struct

# No sensor has more; a rig of three such cameras still fits in memory.
MOST_PIXELS = 200_000_000

_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
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
    """(width, height) that a PNG, JPEG, TIFF, BMP, PNM or WebP announces, None for others."""
    try:
        if content.startswith(b"\x89PNG\r\n\x1a\n"):
            return struct.unpack_from(">II", content, 16)
        if content.startswith(b"\xff\xd8"):
            return _of_jpeg(content)
        if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _of_tiff(content)
        if content.startswith(b"BM"):
            return _of_bmp(content)
        if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
            return _of_webp(content)
        pnm = re.match(rb"P[1-6]" + 2 * rb"(?:\s|#[^\n]*\n)+(\d{1,9})", content[:4096])
        return (int(pnm[1]), int(pnm[2])) if pnm else None
    except struct.error:
        return None


def _of_jpeg(content: bytes) -> tuple[int, int] | None:
    """Of the frame header, SOF0 to SOF15, behind any number of other segments."""
    place = 2
    while place < len(content):
        if content[place] != 0xFF:
            return None
        marker = content[place + 1] if place + 1 < len(content) else 0
        if marker == 0xFF or 0xD0 <= marker <= 0xD7 or marker == 1:
            place += 1 if marker == 0xFF else 2
            continue
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", content, place + 5)
            return width, height
        (length,) = struct.unpack_from(">H", content, place + 2)
        place += 2 + length
    return None


def _of_tiff(content: bytes) -> tuple[int, int] | None:
    """Of the first directory, of a classic or a big TIFF."""
    order = "<" if content[:2] == b"II" else ">"
    big = content[2:4] in (b"+\0", b"\0+")
    (start,) = struct.unpack_from(order + ("Q" if big else "I"), content, 8 if big else 4)
    head, entry, inline = ("Q", 20, 12) if big else ("H", 12, 8)
    (count,) = struct.unpack_from(order + head, content, start)
    found = {}
    for k in range(min(count, 1000)):
        place = start + struct.calcsize(order + head) + k * entry
        tag, kind = struct.unpack_from(order + "HH", content, place)
        form = {1: "B", 3: "H", 4: "I", 16: "Q"}.get(kind)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT) and form is not None:
            (found[tag],) = struct.unpack_from(order + form, content, place + inline)
    if len(found) < 2:
        return None
    return found[_TIFF_WIDTH], found[_TIFF_HEIGHT]


def _of_bmp(content: bytes) -> tuple[int, int]:
    (header,) = struct.unpack_from("<I", content, 14)
    width, height = struct.unpack_from("<HH" if header == 12 else "<ii", content, 18)
    return abs(width), abs(height)


def _of_webp(content: bytes) -> tuple[int, int] | None:
    kind = content[12:16]
    if kind == b"VP8X":
        low, high = (int.from_bytes(content[at : at + 3], "little") + 1 for at in (24, 27))
        return low, high
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", content, 26)
        return width & 0x3FFF, height & 0x3FFF
    return None
