"""Strict reading of JSON files that users edit: each error names file, key and remedy."""

import dataclasses
import difflib
import json
import os
import re
import shlex
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError, expect_path
from trinoc.io.atomic import has_half_characters, read_text, write_text

# Everything that trinoc reads is at most eight deep; Python's own parser fails at thousands.
MOST_NESTED = 64
# What the camera files of other tools hold; those of OpenCV may hold words of ROS, too.
_CAMERA_WORDS = {
    "opencv": "opencv-matrix",
    "ros": "distortion_coefficients:",
    "kalibr": "cam0:",
    "mrcal": "lensmodel",
}
_QUOTED = re.compile(r'"(?:[^"\\]|\\.)*"?', re.DOTALL)


def parsed_json(text: str, file: str | os.PathLike[str]) -> Any:
    """Parse a JSON text strictly and return its value.

    Raise `InputError`, which names `file`, for invalid JSON. NaN, infinities, repeated keys, very
    long numbers, invalid characters and very deep nesting are also refused.
    """
    if not text.strip():
        raise InputError(f"{file} is empty: give another file.")
    _check_depth(text, file)
    try:
        values = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except json.JSONDecodeError as error:
        if os.fspath(file).lower().endswith(".json"):
            position = f"line {error.lineno}, column {error.colno}: {error.msg}"
            raise InputError(f"{file} is not JSON ({position}): correct it there.") from error
        raise InputError(f"{file} is not JSON: {_remedy_for_cameras(text, file)}.") from error
    except _NotStrictError as error:
        raise InputError(f"{file}: {error}") from error
    except ValueError as error:  # of Python, whose integers have at most 4,300 digits
        raise InputError(
            f"{file} contains a number with thousands of digits: write a number such as 1.5e300."
        ) from error
    # Halves of a character, which JSON can name by \\u, cannot be printed or written again.
    if re.search(r"\\u[dD][89a-fA-F]", text) and has_half_characters(
        json.dumps(values, ensure_ascii=False)
    ):
        raise InputError(f"{file} holds a \\u code that is no character: correct it.")
    return values


def _remedy_for_cameras(text: str, file: str | os.PathLike[str]) -> str:
    """Return the remedy for a file that is not JSON.

    If the file looks like another tool's cameras, this is the export command.
    """
    name = next((name for name, mark in _CAMERA_WORDS.items() if mark in text), None)
    if name is None:
        return "give the .json file"
    return (
        f"write one with `trinoc export {shlex.quote(os.fspath(file))} --from {name} -o "
        f"{'camera' if name == 'ros' else 'rig'}.json`, and give that"
    )


class _NotStrictError(Exception):
    """A text is not valid JSON, but Python's parser accepts it."""


def _check_depth(text: str, file: str | os.PathLike[str]) -> None:
    depth = 0
    for bracket in re.findall(r"[\[\]{}]", _QUOTED.sub("", text)):
        depth += 1 if bracket in "[{" else -1
        if depth > MOST_NESTED:
            raise InputError(
                f"{file} is nested more than {MOST_NESTED} deep, which no such file is: give "
                "another file."
            )


def _refuse_constant(name: str) -> float:
    raise _NotStrictError(
        f"{name} is not a finite number, and a file can contain only finite numbers: correct this "
        "number."
    )


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise _NotStrictError(
            f"the key {json.dumps(twice)} occurs twice in one object: keep one of the two."
        )
    return values


# Squares and cubes of larger numbers are more than floats hold.
LARGEST = 1e60


@dataclasses.dataclass(frozen=True)
class Block:
    """A JSON object with checked access to its values.

    Attributes
    ----------
    values : dict
        The object.
    file : str
        File that contains the object, for messages.
    place : str
        Key path of the object in the file, such as "cameras.upper"; empty for the whole file.
    """

    values: dict[str, Any]
    file: str
    place: str

    def error(self, key: str, problem: str) -> InputError:
        """Return an `InputError` that names file and key; `problem` completes the sentence."""
        key_path = json.dumps(self._path(key), ensure_ascii=False)
        return InputError(f"{self.file}: {key_path} {problem}")

    def expect_keys(self, required: Collection[str], optional: Collection[str] = ()) -> None:
        """Raise `InputError` for a missing required key, or a key in neither list."""
        keys = [*required, *optional]
        for key in self.values:
            if key not in keys:
                similar = difflib.get_close_matches(key, keys, n=1)
                remedy = f"remove it ({_list_keys(keys)})."
                if similar:
                    remedy = f'did you mean "{similar[0]}"?'
                raise self.error(key, f"is an unknown key: {remedy}")
        for key in required:
            if key not in self.values:
                raise self.error(key, "is missing: add it.")

    def block(self, key: str) -> "Block":
        """Return the object under a key. Raise `InputError` for other values."""
        value = self.values.get(key)
        if not isinstance(value, dict):
            raise self.error(key, f"must be an object in braces, but is {show_value(value)}.")
        return Block(value, self.file, self._path(key))

    def blocks(self) -> "Iterator[tuple[str, Block]]":
        """Iterate over (key, object). Raise `InputError` if a value is not an object."""
        for key in self.values:
            yield key, self.block(key)

    def text(self, key: str) -> str:
        """Return the string under a key. Raise `InputError` for other values."""
        value = self.values.get(key)
        if not isinstance(value, str):
            raise self.error(key, f"must be a text in quotes, but is {show_value(value)}.")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return the strings of the list under a key. Raise `InputError` for other values."""
        value = self.values.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.error(key, f"must be a list of texts in quotes, but is {show_value(value)}.")
        return tuple(value)

    def number(self, key: str) -> float:
        """Return the finite number under a key. Raise `InputError` for other values."""
        return float(self.numbers(key, ()))

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """Return the finite numbers under a key as a float64 array of the given shape.

        None in `shape` accepts any length. Raise `InputError` for other values.
        """
        value = self.values.get(key)
        if not _only_numbers(value):
            raise self.error(key, f"must be {_describe_shape(shape)}, but is {show_value(value)}.")
        try:
            array = np.array(value, dtype=np.float64)
        except (ValueError, OverflowError):
            array = np.array(np.nan)
        if array.size == 0 and len(shape) > array.ndim:
            array = array.reshape((0,) * len(shape))
        if not (
            array.ndim == len(shape)
            and all(want in (None, got) for want, got in zip(shape, array.shape, strict=True))
            and np.isfinite(array).all()
        ):
            raise self.error(key, f"must be {_describe_shape(shape)}, but is {show_value(value)}.")
        if (np.abs(array) > LARGEST).any():
            raise self.error(
                key,
                f"contains {np.abs(array).max():g}, which is too large for a measured value: check "
                "the number and its unit.",
            )
        return array

    def image_size_px(self, key: str = "image_size_px") -> tuple[int, int]:
        """Return the image size (width, height) under a key.

        Raise `InputError` if the value is not two positive whole numbers.
        """
        size = self.numbers(key, (2,))
        if not ((size >= 1).all() and (size == np.round(size)).all()):
            raise self.error(key, "must be [width, height] in whole positive pixels.")
        return int(size[0]), int(size[1])

    def _path(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key


def read_document(path: str | os.PathLike[str], format_name: str, version: int) -> Block:
    """Read a JSON file that begins {"format": format_name, "version": version, ...}.

    Raise `InputError` if the file is missing, is not JSON, or has another format or version.
    """
    expect_path(path)
    file = Path(path)
    values = parsed_json(read_text(file), file)
    if not isinstance(values, dict) or values.get("format") != format_name:
        stated = values.get("format") if isinstance(values, dict) else None
        raise InputError(
            f'{file} has the format {show_value(stated)}, but "{format_name}" is needed: '
            "give another file."
        )
    if isinstance(values.get("version"), bool) or values.get("version") != version:
        raise InputError(
            f"{file} has version {show_value(values.get('version'))} of {format_name}, but this "
            f"trinoc reads version {version}: update trinoc or write the file again."
        )
    return Block(values, str(file), "")


def write_document(path: str | os.PathLike[str], values: dict[str, Any]) -> None:
    """Write an object as indented JSON with short lists on one line.

    Raise `InputError`, before anything is written, for values that `parsed_json` would refuse.
    """
    try:
        text = document_text(values)
        parsed_json(text, "it")
    except (TypeError, ValueError) as error:
        raise InputError(f"{path} was not written: {error}") from error
    write_text(path, text)


def document_text(values: dict[str, Any]) -> str:
    """Return the JSON text that `write_document` writes."""
    return _dump(values, "") + "\n"


def _dump(value: Any, indent: str) -> str:
    if isinstance(value, dict) and value:
        deeper = indent + "  "
        items = ((json.dumps(str(key)), _dump(item, deeper)) for key, item in value.items())
        lines = (f"{deeper}{key}: {item}" for key, item in items)
        return "{\n" + ",\n".join(lines) + "\n" + indent + "}"
    flat = json.dumps(value, allow_nan=False)
    if isinstance(value, list) and len(flat) > 88:
        deeper = indent + "  "
        return "[\n" + ",\n".join(deeper + _dump(item, deeper) for item in value) + f"\n{indent}]"
    return flat


def _only_numbers(value: Any) -> bool:
    if isinstance(value, list):
        return all(_only_numbers(item) for item in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def _describe_shape(shape: tuple[int | None, ...]) -> str:
    if not shape:
        return "a finite number"
    size = " x ".join("n" if side is None else str(side) for side in shape)
    return f"a list of {size} finite numbers"


def show_value(value: Any) -> str:
    """Return a value as JSON for a message, cut at 60 characters; "missing" for None."""
    text = "missing" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _list_keys(keys: Collection[str]) -> str:
    return "known here: " + ", ".join(keys)
