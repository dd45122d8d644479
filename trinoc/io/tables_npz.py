"""Tables as npz files: one array for each field, checked against the declared columns."""

import itertools
import os
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

import numpy as np

from trinoc.errors import InputError
from trinoc.io.arrays_npz import read_arrays, write_arrays
from trinoc.numerics.tables import (
    Content,
    Field,
    Table,
    list_fields,
)

_Value = TypeVar("_Value", bound=Table)

VERSION = 1
REMEDY = "write the file again"
_IN_WORDS = {"f": "real numbers", "i": "whole numbers", "b": "truth values", "U": "texts"}
_DTYPES = {"f": np.float64, "i": np.int64, "b": np.bool_}


def save_npz(table: Table, path: str | os.PathLike[str]) -> None:
    """Write a table as an npz file, which appears complete or not at all.

    Fields that are None are left out. Raise `InputError`, before anything is written, for a table
    that `load_npz` would refuse.
    """
    write_arrays(path, f"trinoc-{table.KIND}", VERSION, checked_arrays(table, path))


def checked_arrays(table: Table, path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Return the arrays that store a table, after a test that `build_table` can read them.

    Raise `InputError` otherwise.
    """
    arrays = list_arrays(table)
    fields = ArrayFields(arrays, f"{path} was not written", remedy="correct the value")
    read = list_arrays(build_table(type(table), fields))
    for name in arrays:
        if name not in read:
            raise fields.error(name, "has a name with which it could not be read again")
    return arrays


def load_npz(kind: type[_Value], path: str | os.PathLike[str]) -> _Value:
    """Read a table of class `kind` from a file of `save_npz`.

    Raise `InputError` for another file or an invalid value. The message names the field and the
    first invalid row.
    """
    return build_table(kind, ArrayFields(read_arrays(path, f"trinoc-{kind.KIND}", VERSION), path))


def list_arrays(table: Table, prefix: str = "") -> dict[str, np.ndarray]:
    """Arrays that store a table in a file, keyed by name. `prefix` begins each name."""
    arrays: dict[str, np.ndarray] = {}
    for field in list_fields(type(table)):
        name, value = prefix + field.name, getattr(table, field.name)
        match value:
            case Table():
                arrays |= list_arrays(value, prefix + field.array_prefix)
            case dict() if field.type == dict[str, int]:
                for key, array in zip(_names_of_counts(name), (list(value), list(value.values()))):
                    arrays[key] = _array(array, "iU"[key.endswith("names")])
            case dict():
                arrays |= {prefix + field.array_prefix + key: _array(a) for key, a in value.items()}
            case tuple() if field.column.blocks:
                flat = [np.asarray(block).reshape(-1) for block in value]
                arrays[name] = np.concatenate([*flat, np.zeros(0)])
            case tuple():
                arrays[name] = _array(value, "U" if field.type == tuple[str, ...] else "i")
            case float():
                arrays[name] = np.array(value)
            case _ if value is not None:
                arrays[name] = _array(value, field.kind)
    return arrays


def build_table(kind: type[_Value], fields: "ArrayFields") -> _Value:
    """Create a table of class `kind` from the arrays of a file.

    Raise `InputError` for an invalid value. The message names the field and the first invalid row.
    """
    read = Content({}, {})
    # What stands beside the columns is what these leave; blocks are as large as these say.
    dependent = [f for f in list_fields(kind) if f.column.per_row or f.column.blocks]
    for group in ([field for field in list_fields(kind) if field not in dependent], dependent):
        for field in group:
            if not field.optional or fields.has(field):
                read.values[field.name] = _read(field, fields, read, kind.SIDES)
        for field in group:
            value = read.values.get(field.name)
            for check in field.column.checks if value is not None else ():
                fields.expect(field.name, check.good(value, read), check.problem)
    return kind(**read.values)


def _read(field: Field, fields: "ArrayFields", read: Content, side_names: Mapping[str, str]) -> Any:
    """Value of one field from the arrays of a file.

    `read` contains the fields that were read before, and the lengths of their axes by name. The
    axis lengths of this array are added to it. Raise `InputError` if the array is missing or of
    another type or shape.
    """
    name, column = field.name, field.column
    if isinstance(field.type, type) and issubclass(field.type, Table):
        return build_table(field.type, fields.below(field.array_prefix))
    if field.type == dict[str, int]:
        names, values = _names_of_counts(name)
        texts = fields.take(names, "U", (None,), name)
        numbers = fields.take(values, "i", texts.shape, f"{len(texts)} names")
        return dict(zip(map(str, texts), map(int, numbers), strict=True))
    if typing.get_origin(field.type) is dict:
        inner, sides = (
            fields.below(field.array_prefix),
            typing.get_args(field.type)[1].dim_str.split(),
        )
        if "..." in sides:
            return {key: inner.arrays[inner.prefix + key] for key in inner.remaining()}
        return {key: inner.take(key, "U", (None,), "words") for key in inner.every()}
    if column.blocks:
        sizes = column.blocks(read)
        ends = np.cumsum([0, *(size**2 for size in sizes)])
        flat = fields.take(name, "f", (int(ends[-1]),), f"{len(sizes)} blocks")
        flat_blocks = [flat[start:end] for start, end in itertools.pairwise(ends)]
        return tuple(p.reshape(n, n) for p, n in zip(flat_blocks, sizes, strict=True))
    if field.type is float:
        return float(fields.take(name, "f", (), "values"))
    if field.type == tuple[str, ...]:
        texts = fields.take(name, "U", (None,), name)
        if column.side:
            read.sides[column.side] = len(texts)
        return tuple(map(str, texts))
    if typing.get_origin(field.type) is tuple:
        return tuple(map(int, fields.take(name, "i", (None,), name))) or None
    named_sides = [side for side in field.sides if side in side_names]
    what = " in ".join(
        f"{read.sides.get(side, '')} {side_names[side]}".strip() for side in named_sides
    )
    shape = [int(side) if side.isdigit() else read.sides.get(side) for side in field.sides]
    array = fields.take(name, field.kind, tuple(shape), what or "values")
    read.sides.update((s, n) for s, n in zip(field.sides, array.shape) if not s.isdigit())
    return array


def _names_of_counts(name: str) -> tuple[str, str]:
    """Names of the two arrays that store a dictionary of numbers: its keys, and its values."""
    return f"{name.removesuffix('s')}_names", f"{name.removesuffix('s')}_values"


def _array(values: Any, kind: str = "") -> np.ndarray:
    """Convert values to an array that a file can store without pickle.

    Strings get a fixed width.
    """
    array = np.asarray(values)
    if kind == "U" or array.dtype.kind in "OU":
        return array.astype(np.str_) if array.size else np.zeros(array.shape, "<U1")
    return array.astype(np.int64) if kind == "i" else array


class ArrayFields:
    """The arrays of one file, with checked access by name. Every message names the file.

    Attributes
    ----------
    arrays : mapping of arrays
        All arrays, keyed by name.
    file : path
        Name of the file, for messages.
    prefix : str
        Beginning of the array names that this object gives access to.
    remedy : str
        End of each message.
    """

    def __init__(
        self,
        arrays: Mapping[str, np.ndarray],
        file: str | os.PathLike[str],
        prefix: str = "",
        remedy: str = REMEDY,
    ) -> None:
        self.arrays, self.file, self.prefix, self.remedy = arrays, file, prefix, remedy
        self._taken: set[str] = set()

    def has(self, field: Field) -> bool:
        """True if the file contains an array of the field."""
        if field.type == dict[str, int]:
            return self.prefix + _names_of_counts(field.name)[0] in self.arrays
        if typing.get_origin(field.type) is dict or hasattr(field.type, "KIND"):
            return any(name.startswith(self.prefix + field.array_prefix) for name in self.arrays)
        return self.prefix + field.name in self.arrays

    def below(self, prefix: str) -> "ArrayFields":
        """Return access to the arrays whose names begin with a further prefix."""
        if not prefix:
            return self
        return ArrayFields(self.arrays, self.file, self.prefix + prefix, self.remedy)

    def every(self) -> list[str]:
        """Names of all arrays, without the prefix. A name may contain "/", as camera names may."""
        return [n.removeprefix(self.prefix) for n in self.arrays if n.startswith(self.prefix)]

    def remaining(self) -> list[str]:
        """Names without "/" of the arrays that `take` has not returned yet."""
        return [name for name in self.every() if name not in self._taken and "/" not in name]

    def take(self, name: str, kind: str, shape: tuple[int | None, ...], what: str) -> np.ndarray:
        """Return an array after a check of its type and shape.

        Parameters
        ----------
        name : str
            Name of the array, without the prefix.
        kind : str
            Type: "f" for float64, "i" for int64, "b" for bool, "U" for strings.
        shape : tuple
            Required shape; None accepts any length.
        what : str
            Noun in the message "has shape (2,), but `what` need (3,)", such as "3 views".

        Returns
        -------
        array

        Raises
        ------
        InputError
            If the array is missing or has another type or shape.
        """
        full_name = self.prefix + name
        if full_name not in self.arrays:
            raise InputError(f'{self.file} lacks the array "{full_name}": {self.remedy}.')
        array = self.arrays[full_name]
        self._taken.add(name)
        if len(shape) != array.ndim or any(
            want not in (None, got) for want, got in zip(shape, array.shape, strict=True)
        ):
            raise self.error(name, f"has shape {array.shape}, but {what} need {_show_shape(shape)}")
        if array.dtype.kind not in {"f": "fiu", "i": "iu", "b": "b", "U": "U"}[kind]:
            if not (array.size == 0 and array.dtype.kind in "fiubU"):
                raise self.error(name, f"must be {_IN_WORDS[kind]}, but is {array.dtype}")
            return np.zeros(array.shape, "<U1" if kind == "U" else _DTYPES[kind])
        if kind == "U":
            return array
        if array.dtype == np.uint64 and (array > np.iinfo(np.int64).max).any():
            raise self.error(name, "holds numbers that are too large")
        return array.astype(_DTYPES[kind])

    def expect(self, name: str, good: Any, problem: str) -> None:
        """Raise `InputError` if an element of `good` is False; the message names its first row.

        `name` is the array and `problem` the end of the message.
        """
        good = np.asarray(good)
        if good.all():
            return
        rows = good.reshape(len(good), -1).all(axis=1) if good.ndim else good
        where = f"of row {int(np.flatnonzero(~rows)[0])} " if good.ndim else ""
        raise self.error(name, where + problem)

    def error(self, name: str, problem: str) -> InputError:
        """Return an `InputError` that names file and array; `problem` completes the sentence."""
        return InputError(f'{self.file}: "{self.prefix}{name}" {problem}: {self.remedy}.')


def _show_shape(shape: tuple[int | None, ...]) -> str:
    return f"({', '.join('n' if side is None else str(side) for side in shape)})"
