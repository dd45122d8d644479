"""Text of other tools (JSON, YAML), read whole up to a bounded size and parsed without running
anything; folders that are whole or not there.
"""

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
from trinoc.io.atomic import read_text
from trinoc.io.json_document import Block, parsed_json


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


def read_json(path: str | os.PathLike[str]) -> Block:
    """The object of a JSON file. Raises InputError for other content and for a key given twice."""
    values = parsed_json(read_text(path), path)
    return make_block(values, path)


def make_block(values: Any, path: str | os.PathLike[str]) -> Block:
    """A parsed object with the file's name, for checks. Raises InputError for anything else."""
    if not isinstance(values, dict):
        raise InputError(f"{path} holds no named values: give another file.")
    return Block(values, str(path), "")


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
                f'The camera "{name}" names a file in {title}: rename it without / \\ : * ? " < > '
                "| and without dots and blanks at its ends."
            )
        if len(name.encode("utf-8")) > LONGEST_CAMERA_NAME:
            raise InputError(
                f'The camera "{name}" names a file in {title}: rename it with at most '
                f"{LONGEST_CAMERA_NAME} letters."
            )
        plain = unicodedata.normalize("NFC", name).casefold()
        if plain in name_of:
            raise InputError(
                f'The cameras "{name_of[plain]}" and "{name}" name the same file of {title} on '
                "some systems: rename one of them."
            )
        name_of[plain] = name


# Parsing takes some hundred times as long as reading.
MOST_BYTES_OF_YAML = 16_000_000
# What cv2.FileStorage writes, without the blank that YAML wants; the line stays, for errors.
_OPENCV_DIRECTIVE = re.compile(r"\A%YAML:.*")


def read_yaml(path: str | os.PathLike[str]) -> Block:
    """The map of a YAML file; of a stream of several, which must agree but for their `header`.

    Raises InputError as `read_yaml_stream`.
    """
    first, *others = read_yaml_stream(path)
    for number, other in enumerate(others, 2):
        if {**other.values, "header": None} != {**first.values, "header": None}:
            raise InputError(
                f"{path} holds {1 + len(others)} documents, and document {number} differs from the "
                "first: keep the one that is meant."
            )
    return first


def read_yaml_stream(path: str | os.PathLike[str]) -> list[Block]:
    """The maps of a YAML file, one or several: `ros2 topic echo` ends each with the line `---`.

    Tags, anchors and aliases are refused: no calibration needs them. OpenCV's own first line,
    `%YAML:1.0`, is taken. Raises InputError, also where ruamel.yaml is not installed.
    """
    try:
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError
    except ImportError as error:
        raise InputError(
            f"{path} is YAML, which needs ruamel.yaml: pip install 'trinoc[export]'."
        ) from error
    text = _OPENCV_DIRECTIVE.sub("", read_text(path, MOST_BYTES_OF_YAML))
    parser = YAML(typ="safe", pure=True)
    try:
        for event in parser.parse(text):
            if getattr(event, "tag", None) is not None or getattr(event, "anchor", None):
                raise InputError(
                    f"{path} has a tag or an anchor in line {event.start_mark.line + 1}, which "
                    "trinoc does not follow: write plain numbers and texts."
                )
        documents = [values for values in parser.load_all(text) if values is not None]
    except (YAMLError, ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        mark = getattr(error, "problem_mark", None)
        line = "" if mark is None else f" (line {mark.line + 1}: {getattr(error, 'problem', '')})"
        raise InputError(f"{path} is not YAML{line}: correct it there.") from error
    blocks = [make_block(_only_json(values, path), path) for values in documents]
    return blocks or [make_block(None, path)]


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


def _only_json(value: Any, path: str | os.PathLike[str]) -> Any:
    """What JSON could hold, too. Raises InputError for dates, binary data and the like."""
    if isinstance(value, dict):
        return {str(key): _only_json(item, path) for key, item in value.items()}
    if isinstance(value, list):
        return [_only_json(item, path) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise InputError(f"{path} holds a {type(value).__name__}, but only numbers and texts are read.")
