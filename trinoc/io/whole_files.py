"""Files read whole: what is missing, unreadable or far too large is said in a sentence."""

import os
from pathlib import Path
from typing import BinaryIO

from trinoc.errors import InputError

# A rig of a hundred cameras with its covariance has 10 MB.
MOST_BYTES = 64_000_000
_PART_BYTES = 1 << 22


def read_bytes(path: str | os.PathLike[str], most: int = MOST_BYTES) -> bytes:
    """The content of a file. Raises InputError where it is missing, unreadable or huge.

    No more than `most` bytes are read, also of a pipe or a device, which have no size.
    """
    file = Path(path)
    try:
        with file.open("rb") as stream:
            size = os.fstat(stream.fileno()).st_size
            content = _read(stream, most + 1) if size <= most else b""
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{file} cannot be read ({reason}): give a readable file.") from error
    if max(size, len(content)) > most:
        raise InputError(
            f"{file} has {max(size, len(content)) / 1e6:.0f} MB, but no such file has more than "
            f"{most / 1e6:.0f}: give another file."
        )
    return content


def _read(stream: BinaryIO, most: int) -> bytes:
    """Up to `most` bytes. Python takes memory for all that one call may read."""
    parts = []
    while most > 0 and (part := stream.read(min(most, _PART_BYTES))):
        parts.append(part)
        most -= len(part)
    return b"".join(parts)


def read_text(path: str | os.PathLike[str], most: int = MOST_BYTES) -> str:
    """The text of a file, with or without a byte-order mark. Raises InputError for no UTF-8."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is no text file (UTF-8): give another file, or save it as UTF-8."
        ) from error
