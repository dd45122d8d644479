"""Text of other tools as plain values, each notation parsed by a library and none of it run.

`parse_file` is the one place that bounds the size of a file, calls the library, and turns what it
raises into one sentence. A format declares its notation. What is compiled and may crash on a
damaged file, such as SciPy's reader of MATLAB files, runs in a process of its own instead
(`child_process`).
"""

import os
import re
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from trinoc.errors import InputError
from trinoc.io.atomic import MOST_BYTES, read_text
from trinoc.io.json_document import Block, parsed_json

# Libraries in Python take some hundred times as long to parse as to read.
MOST_BYTES_OF_TEXT = 16_000_000


class RefusedError(Exception):
    """A part of a text that trinoc does not follow; the message goes on after the file's name."""


class Notation(NamedTuple):
    """A notation and the library that parses it.

    title : as a message goes on after "is not". parse : the text as values; it may raise
    RefusedError. faults : what the library raises for a text that it cannot read. most_bytes : of
    a file.
    """

    title: str
    parse: Callable[[str], Any]
    faults: tuple[type[Exception], ...]
    most_bytes: int = MOST_BYTES_OF_TEXT


def parse_file(path: str | os.PathLike[str], notation: Notation) -> Any:
    """The values in a file of a notation. Raises InputError, in one sentence with the file."""
    text = read_text(path, notation.most_bytes)
    try:
        return notation.parse(text)
    except RefusedError as error:
        raise InputError(f"{path} {error}") from error
    except (*notation.faults, RecursionError, MemoryError) as error:
        problem = " ".join(str(error).split())[:200]
        detail = f" ({problem})" if problem else ""
        raise InputError(
            f"{path} is not {notation.title}{detail}: correct it there, or give another file."
        ) from error


def make_block(values: Any, path: str | os.PathLike[str]) -> Block:
    """A parsed object with the file's name, for checks. Raises InputError for anything else."""
    if not isinstance(values, dict):
        raise InputError(f"{path} holds no named values: give another file.")
    return Block(values, str(path), "")


def read_json(path: str | os.PathLike[str]) -> Block:
    """The object of a JSON file. Raises InputError for other content and for a key given twice."""
    return make_block(parsed_json(read_text(path, MOST_BYTES), path), path)


def read_yaml(path: str | os.PathLike[str]) -> Block:
    """Read the map of a YAML file.

    If the file has several documents, they must be equal except for `header`, and the first is
    returned. Raises InputError as `read_yaml_stream`.
    """
    first, *others = read_yaml_stream(path)
    for number, other in enumerate(others, 2):
        if {**other.values, "header": None} != {**first.values, "header": None}:
            raise InputError(
                f"{path} contains {1 + len(others)} documents, and document {number} differs from "
                "the first: keep one document."
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
    parse = partial(_parse_yaml, YAML(typ="safe", pure=True))
    documents = parse_file(path, Notation("YAML", parse, (YAMLError, ValueError)))
    return [make_block(values, path) for values in documents or [None]]


# What cv2.FileStorage writes, without the blank that YAML wants; the line stays, for errors.
_OPENCV_DIRECTIVE = re.compile(r"\A%YAML:.*")


def _parse_yaml(parser: Any, text: str) -> list[Any]:
    from ruamel.yaml.error import MarkedYAMLError

    text = _OPENCV_DIRECTIVE.sub("", text)
    try:
        for event in parser.parse(text):
            if getattr(event, "tag", None) is not None or getattr(event, "anchor", None):
                raise RefusedError(
                    f"has a tag or an anchor in line {event.start_mark.line + 1}, which trinoc "
                    "does not follow: write plain numbers and texts."
                )
        return [_only_json(values) for values in parser.load_all(text) if values is not None]
    except MarkedYAMLError as error:
        mark = error.problem_mark
        line = "" if mark is None else f"line {mark.line + 1}: "
        raise ValueError(f"{line}{error.problem}") from error


def _only_json(value: Any) -> Any:
    """A value of YAML as JSON holds it. Raises RefusedError for dates, binary data and such."""
    if isinstance(value, dict):
        return {str(key): _only_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_only_json(item) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise RefusedError(f"holds a {type(value).__name__}, but only numbers and texts are read.")
