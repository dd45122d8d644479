"""Reading text of other tools: whole, of a bounded size, and parsed without running anything."""

import json
import os
import re
from pathlib import Path
from typing import Any

from trinoc.errors import InputError
from trinoc.io.json_document import Block

# No calibration is longer. A model of thousands of pictures is, with what they show.
MOST_BYTES, MOST_BYTES_OF_MODEL = 16_000_000, 1_000_000_000


def read_bytes(path: str | os.PathLike[str], most: int = MOST_BYTES) -> bytes:
    """The content of a file. Raises InputError where it is missing, unreadable or huge."""
    file = Path(path)
    try:
        size = file.stat().st_size
        if size > most:
            raise InputError(
                f"{file} has {size / 1e6:.0f} MB, but no calibration has more than "
                f"{most / 1e6:.0f}: give another file."
            )
        return file.read_bytes()
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except OSError as error:
        raise InputError(f"{file} cannot be read ({error.strerror}): give a file.") from error


def read_text(path: str | os.PathLike[str], most: int = MOST_BYTES) -> str:
    """The text of a file. Raises InputError, also for what is no UTF-8."""
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is no text file: give another file.") from error


def read_json(path: str | os.PathLike[str]) -> Block:
    """The object of a JSON file. Raises InputError for other content and for a key given twice."""
    text = read_text(path)
    try:
        values = json.loads(text, object_pairs_hook=lambda pairs: _unique(pairs, path))
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is not JSON ({error}): correct it there.") from error
    return block_of(values, path)


def block_of(values: Any, path: str | os.PathLike[str]) -> Block:
    """A parsed object with the file's name, for checks. Raises InputError for anything else."""
    if not isinstance(values, dict):
        raise InputError(f"{path} holds no named values: give another file.")
    return Block(values, str(path), "")


def expect_file_name(name: str, title: str) -> str:
    """A camera's name that names a file, too. Raises InputError for others."""
    if not re.fullmatch(r'[^/\\:*?"<>|]+', name) or name.strip(". ") != name:
        raise InputError(
            f'The camera "{name}" names a file in {title}: rename it without / \\ : * ? " < > | '
            "and without dots and blanks at its ends."
        )
    return name


def _unique(pairs: list[tuple[str, Any]], path: str | os.PathLike[str]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise InputError(f"{path} has a key twice in one object: keep one of them.")
    return values
