"""Folders, file names and YAML text for the text files of other tools."""

import contextlib
import json
import os
import re
import secrets
import shutil
import unicodedata
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from trinoc.errors import InputError


@contextlib.contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """Context manager for a scratch folder that is renamed to `target` at the end of the block.

    If the block fails, the scratch folder is deleted. `target` must be new or empty. Raise
    `InputError` if the folder cannot be created.
    """
    scratch = target.absolute().with_name(f".{target.name}.{secrets.token_hex(4)}.tmp")
    try:
        scratch.mkdir()
    except OSError as error:
        raise InputError(
            f"{target} cannot be written ({error.strerror}): choose another place."
        ) from error
    try:
        yield scratch
        if target.is_dir():
            target.rmdir()  # fails unless empty
        os.replace(scratch, target)
    except BaseException:
        shutil.rmtree(scratch, ignore_errors=True)
        raise


# A model of thousands of pictures, with what they show.
MOST_BYTES_OF_MODEL = 1_000_000_000


# In bytes, with room for the ending.
LONGEST_CAMERA_NAME = 200


def expect_file_names(names: Iterable[str], title: str) -> None:
    """Raise `InputError` for camera names that cannot be file names in one folder on every system.

    Such a name is too long, or has a character that some system refuses. Two names also conflict if
    they differ only by upper and lower case or by Unicode composition. `title` names the format in
    the message.
    """
    name_of: dict[str, str] = {}
    for name in names:
        if not re.fullmatch(r'[^/\\:*?"<>|]+', name) or name.strip(". ") != name:
            raise InputError(
                f'The name of the camera "{name}" becomes a file name in {title}: rename the '
                'camera without / \\ : * ? " < > | and without dots and blanks at the ends of the '
                "name."
            )
        if len(name.encode("utf-8")) > LONGEST_CAMERA_NAME:
            raise InputError(
                f'The name of the camera "{name}" becomes a file name in {title}: rename the '
                f"camera with at most {LONGEST_CAMERA_NAME} letters."
            )
        key = unicodedata.normalize("NFC", name).casefold()
        if key in name_of:
            raise InputError(
                f'The names of the cameras "{name_of[key]}" and "{name}" become the same file '
                f"name in {title} on some systems: rename one of the cameras."
            )
        name_of[key] = name


def yaml_text(values: Any, indent: str = "") -> str:
    """Convert maps, lists, numbers and strings to YAML text.

    Maps are written in block style, and a list of numbers on one line. Strings are quoted and
    floats have a decimal point, so that all versions of YAML read the same values.
    """
    if isinstance(values, dict):
        return "".join(f"{indent}{key}:{_item(value, indent)}" for key, value in values.items())
    lines = []
    for value in values:
        if isinstance(value, dict):
            inner = yaml_text(value, indent + "  ")
            lines.append(f"{indent}- {inner.removeprefix(indent + '  ')}")
        else:
            lines.append(f"{indent}- {scalar_or_list(value)}\n")
    return "".join(lines)


def scalar_or_list(value: Any) -> str:
    """YAML text on one line of a number, a string, or a list of these."""
    if isinstance(value, list):
        return f"[{', '.join(map(scalar_or_list, value))}]"
    if isinstance(value, float):
        digits = repr(value)
        mantissa, mark, exponent = digits.partition("e")
        # PyYAML takes 1e-05 for a text.
        return digits if "." in mantissa else f"{mantissa}.0{mark}{exponent}"
    return json.dumps(value, ensure_ascii=False)


def _item(value: Any, indent: str) -> str:
    if isinstance(value, dict) or (
        isinstance(value, list) and any(isinstance(item, dict | list) for item in value)
    ):
        return "\n" + yaml_text(value, indent + "  ")
    return f" {scalar_or_list(value)}\n"
