"""Names, numbers and folders as other tools' text files have them."""

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
    """A scratch folder that takes the name `target` when the block ends, and vanishes if it fails.

    `target` is new or empty. Raises InputError where it cannot be written.
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
    """Check that names of cameras can name files beside each other, on every system.

    Raises InputError for letters that some system refuses, for a name that is too long, and for two
    names that are one where capital letters or composed characters make no difference.
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
        plain = unicodedata.normalize("NFC", name).casefold()
        if plain in name_of:
            raise InputError(
                f'The names of the cameras "{name_of[plain]}" and "{name}" become the same file '
                f"name in {title} on some systems: rename one of the cameras."
            )
        name_of[plain] = name


def yaml_text(values: Any, indent: str = "") -> str:
    """Maps in block style, lists of numbers in one line, lists of others below each other.

    Texts are quoted, and numbers have a point, so that every version of YAML reads them alike.
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
    """A number, a text, or a list of them on one line."""
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
