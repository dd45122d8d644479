"""Reading text of other tools: whole, of a bounded size, and parsed without running anything."""

import os
import re
from typing import Any

from trinoc.errors import InputError
from trinoc.io.json_document import Block
from trinoc.io.json_text import parsed_json
from trinoc.io.whole_files import read_text

# A model of thousands of pictures, with what they show.
MOST_BYTES_OF_MODEL = 1_000_000_000


def read_json(path: str | os.PathLike[str]) -> Block:
    """The object of a JSON file. Raises InputError for other content and for a key given twice."""
    values = parsed_json(read_text(path), path)
    return make_block(values, path)


def make_block(values: Any, path: str | os.PathLike[str]) -> Block:
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
