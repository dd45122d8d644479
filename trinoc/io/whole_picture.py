"""Has a picture been written to its end? Sources: the PNG specification; T.81 for JPEG."""

import os
from pathlib import Path

_PNG, _PNG_END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"
_JPEG, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
# Cameras may add something behind the end.
_TAIL = 4096


def is_whole_picture(path: str | os.PathLike[str]) -> bool:
    """Whether a file that is a PNG or JPEG has its end mark; others are whole where not empty.

    Raises OSError.
    """
    with Path(path).open("rb") as file:
        start = file.read(8)
        file.seek(max(0, file.seek(0, os.SEEK_END) - _TAIL))
        return bool(start) and ends_as_it_should(start, file.read())


def ends_as_it_should(start: bytes, tail: bytes | None = None) -> bool:
    """The same of the content; `tail` is its last part where `start` is not all of it."""
    end = start if tail is None else tail
    if start.startswith(_PNG):
        return _PNG_END in end
    return _JPEG_END in end if start.startswith(_JPEG) else True
