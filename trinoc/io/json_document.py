"""Reading JSON files that people edit: every mistake is named by file, place and remedy."""

import dataclasses
import difflib
import json
import os
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.io.atomic import write_text
from trinoc.io.json_text import parsed_json
from trinoc.io.whole_files import read_text

# Squares and cubes of larger numbers are more than floats hold.
LARGEST = 1e60


@dataclasses.dataclass(frozen=True)
class Block:
    """A JSON object, the file it came from, and its place in there ("cameras.upper")."""

    values: dict[str, Any]
    file: str
    place: str

    def error(self, key: str, problem: str) -> InputError:
        """An error that names the file and the key; `problem` completes the sentence."""
        place = json.dumps(self._path(key), ensure_ascii=False)
        return InputError(f"{self.file}: {place} {problem}")

    def expect_keys(self, required: Collection[str], optional: Collection[str] = ()) -> None:
        """Raise InputError for a key that is missing or that nobody would read."""
        known = [*required, *optional]
        for key in self.values:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                remedy = (
                    f'did you mean "{near[0]}"?' if near else f"remove it ({_list_keys(known)})."
                )
                raise self.error(key, f"is an unknown key: {remedy}")
        for key in required:
            if key not in self.values:
                raise self.error(key, "is missing: add it.")

    def block(self, key: str) -> "Block":
        """The object under a key."""
        value = self.values.get(key)
        if not isinstance(value, dict):
            raise self.error(key, f"must be an object in braces, but is {_show_value(value)}.")
        return Block(value, self.file, self._path(key))

    def blocks(self) -> "Iterator[tuple[str, Block]]":
        """(key, object) of every key, where all values are objects."""
        for key in self.values:
            yield key, self.block(key)

    def text(self, key: str) -> str:
        """The string under a key."""
        value = self.values.get(key)
        if not isinstance(value, str):
            raise self.error(key, f"must be a text in quotes, but is {_show_value(value)}.")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """The list of strings under a key."""
        value = self.values.get(key)
        if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
            raise self.error(
                key, f"must be a list of texts in quotes, but is {_show_value(value)}."
            )
        return tuple(value)

    def number(self, key: str) -> float:
        """The finite number under a key."""
        return float(self.numbers(key, ()))

    def numbers(self, key: str, shape: tuple[int | None, ...]) -> np.ndarray:
        """The finite numbers under a key, as float64; None in `shape` is any length."""
        value = self.values.get(key)
        if not _only_numbers(value):
            raise self.error(key, f"must be {_describe_shape(shape)}, but is {_show_value(value)}.")
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
            raise self.error(key, f"must be {_describe_shape(shape)}, but is {_show_value(value)}.")
        if (np.abs(array) > LARGEST).any():
            raise self.error(
                key,
                f"holds {np.abs(array).max():g}, which nothing measures: check it and its unit.",
            )
        return array

    def image_size_px(self, key: str = "image_size_px") -> tuple[int, int]:
        """(width, height) under a key, in whole positive pixels."""
        size = self.numbers(key, (2,))
        if not ((size >= 1).all() and (size == np.round(size)).all()):
            raise self.error(key, "must be [width, height] in whole positive pixels.")
        return int(size[0]), int(size[1])

    def _path(self, key: str) -> str:
        return f"{self.place}.{key}" if self.place else key


def read_document(path: str | os.PathLike[str], format_name: str, version: int) -> Block:
    """The whole object of a file `{"format": format_name, "version": version, ...}`.

    Raises InputError for a file that is missing, is not JSON, or has another format or version.
    """
    file = Path(path)
    values = parsed_json(read_text(file), file)
    if not isinstance(values, dict) or values.get("format") != format_name:
        found = values.get("format") if isinstance(values, dict) else None
        raise InputError(
            f'{file} has the format {_show_value(found)}, but "{format_name}" is needed: '
            "give another file."
        )
    if isinstance(values.get("version"), bool) or values.get("version") != version:
        raise InputError(
            f"{file} has version {_show_value(values.get('version'))} of {format_name}, but this "
            f"trinoc reads version {version}: update trinoc or write the file again."
        )
    return Block(values, str(file), "")


def write_document(path: str | os.PathLike[str], values: dict[str, Any]) -> None:
    """Write an object as indented JSON with short lists on one line."""
    write_text(path, document_text(values))


def document_text(values: dict[str, Any]) -> str:
    """The text that `write_document` writes."""
    return _dump(values, "") + "\n"


def _dump(value: Any, indent: str) -> str:
    if isinstance(value, dict) and value:
        deeper = indent + "  "
        lines = (f"{deeper}{json.dumps(key)}: {_dump(item, deeper)}" for key, item in value.items())
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


def _show_value(value: Any) -> str:
    text = "missing" if value is None else json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _list_keys(keys: Collection[str]) -> str:
    return "known here: " + ", ".join(keys)
