"""Parsers of other tools' texts: each notation is parsed by a library to plain values.

`parse_file` limits the size of the file, calls the library, and converts its exceptions to one
sentence. No code in the text is executed. A compiled parser that may crash on a damaged file, such
as SciPy's reader of MATLAB files, runs in a child process instead (`child_process`).
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
    """A text contains a construct that trinoc does not accept.

    The message continues a sentence that begins with the file name.
    """


class Notation(NamedTuple):
    """A text notation such as YAML, with the function that parses it.

    Attributes
    ----------
    title : str
        Name of the notation in messages: "FILE is not YAML".
    parse : callable
        Function of the text that returns its values. It may raise `RefusedError`.
    faults : tuple of exception types
        Exceptions that `parse` raises for a text that is not in this notation.
    most_bytes : int
        Largest accepted file size.
    """

    title: str
    parse: Callable[[str], Any]
    faults: tuple[type[Exception], ...]
    most_bytes: int = MOST_BYTES_OF_TEXT


def parse_file(path: str | os.PathLike[str], notation: Notation) -> Any:
    """Read and parse a file in a notation; return its values.

    Raise `InputError` with one sentence that names the file if it is unreadable or in another
    notation.
    """
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
    """Return a parsed object with its file name as a `Block`, whose methods check the values.

    Raise `InputError` if `values` is not a dictionary.
    """
    if not isinstance(values, dict):
        raise InputError(f"{path} holds no named values: give another file.")
    return Block(values, str(path), "")


def read_json(path: str | os.PathLike[str]) -> Block:
    """Read the object of a JSON file as a `Block`.

    Raise `InputError` if the content is not one object, or a key occurs twice.
    """
    return make_block(parsed_json(read_text(path, MOST_BYTES), path), path)


def read_yaml(path: str | os.PathLike[str]) -> Block:
    """Read the map of a YAML file as a `Block`.

    If the file has several documents, they must be equal except for the key `header`. The first
    document is then returned. Raise `InputError` as `read_yaml_stream` does.
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
    """Read all documents of a YAML file as a list of `Block`.

    `ros2 topic echo`, for example, writes one document for each message. The first line `%YAML:1.0`
    of OpenCV is accepted. Raise `InputError` if the text is not YAML, has tags, anchors or aliases,
    or if the package ruamel.yaml is missing.
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
    """Convert a YAML value to a JSON value: keys of maps become strings.

    Raise `RefusedError` for dates, binary data and other types that JSON does not have.
    """
    if isinstance(value, dict):
        return {str(key): _only_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_only_json(item) for item in value]
    if value is None or isinstance(value, str | int | float):
        return value
    raise RefusedError(f"holds a {type(value).__name__}, but only numbers and texts are read.")
