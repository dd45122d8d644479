"""What a picture announces in its header, before memory is taken for its pixels.

A PNG of one megabyte can announce, and unpack to, gigabytes.
"""

import io
import struct
import warnings

from PIL import Image

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
