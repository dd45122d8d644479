"""The variables of a .mat file of MATLAB 5 to 7, read byte by byte.

SciPy writes these files well, but its reader brings the interpreter down on one damaged file in
a hundred (`benchmarks/library_readers.py`).
Numbers, texts, cells and structs are read, the rest is None. After "MAT-File Format", The
MathWorks, chapter 1.
"""

import math
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from trinoc.errors import InputError
from trinoc.io.formats.text_files import MOST_BYTES, read_bytes

HEADER, TAG = 128, 8
NUMBERS = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
}
MATRIX, COMPRESSED = 14, 15
ENCODINGS = {2: "latin-1", 4: "utf-16-le", 16: "utf-8", 17: "utf-16-le", 18: "utf-32-le"}
CELL, STRUCT, TEXT, NUMERIC = 1, 2, 4, range(6, 16)
COMPLEX = 0x800
MOST_NESTED = 12


def mat_variables(path: Path) -> dict[str, Any]:
    """The variables by name: structs as maps, cells as lists, texts, matrices as lists of rows.

    Raises InputError for a file that is none, of version 7.3 or big-endian, or damaged.
    """
    content = read_bytes(path)
    if content[:20].startswith(b"MATLAB 7.3") or content.startswith(b"\x89HDF"):
        raise InputError(f"{path} is of MATLAB 7.3, another format: save it with -v7.")
    if len(content) < HEADER or content[124:128] != b"\x00\x01IM":
        raise InputError(f"{path} is no .mat file that trinoc reads: save it with -v7.")
    try:
        variables = {}
        body = content[HEADER:]
        while body:
            kind, data, body = _element(body)
            if kind == COMPRESSED:
                kind, data, _ = _element(_unpacked(data))
            if kind == MATRIX:
                name, value = _matrix(data, 0)
                variables[name] = value
        return variables
    except (_DamagedError, struct.error, zlib.error, UnicodeDecodeError) as error:
        raise InputError(f"{path} is damaged ({error}): write it again.") from error


class _DamagedError(Exception):
    """A file says of itself what cannot be."""


def _element(content: bytes) -> tuple[int, bytes, bytes]:
    """(type, data, what follows) of the first element."""
    kind, size = struct.unpack_from("<II", content)
    if kind >> 16:  # a short one, with its data in the tag
        size, kind, start, end = kind >> 16, kind & 0xFFFF, 4, TAG
        if size > 4:
            raise _DamagedError("an element is too long for its place")
    else:
        start = TAG
        padding = 0 if kind == COMPRESSED else -size % 8
        end = start + size + padding
    if start + size > len(content):
        raise _DamagedError("it ends too early")
    return kind, content[start : start + size], content[end:]


def _unpacked(data: bytes) -> bytes:
    stream = zlib.decompressobj()
    content = stream.decompress(data, MOST_BYTES)
    if stream.unconsumed_tail:
        raise _DamagedError("it unpacks to more than any calibration")
    return content


def _matrix(content: bytes, depth: int) -> tuple[str, Any]:
    """(name, value) of an element of type MATRIX; an empty one is an empty matrix."""
    if not content:
        return "", []
    if depth > MOST_NESTED:
        raise _DamagedError("it is nested too deeply")
    _, flags, rest = _element(content)
    flag = struct.unpack_from("<I", flags)[0]
    family = flag & 0xFF
    if family not in (CELL, STRUCT, TEXT, *NUMERIC) or flag & COMPLEX:
        return "", None
    kind, data, rest = _element(rest)
    sides = [int(side) for side in _numbers(kind, data)]
    _, name, rest = _element(rest)
    label = name.decode("ascii")
    if len(sides) != 2 or min(sides) < 0:
        return label, None
    if family == CELL:
        return label, _members(rest, math.prod(sides), depth)[0]
    if family == STRUCT:
        return label, _struct(rest, math.prod(sides), depth)
    kind, data, _ = _element(rest)
    if family == TEXT:
        if kind not in ENCODINGS:
            raise _DamagedError("a text has no encoding")
        return label, data.decode(ENCODINGS[kind])
    numbers = _numbers(kind, data)
    if len(numbers) != math.prod(sides):
        raise _DamagedError("a matrix has not its numbers")
    return label, numbers.astype(np.float64).reshape(sides, order="F").tolist()


def _numbers(kind: int, data: bytes) -> np.ndarray:
    if kind not in NUMBERS or len(data) % int(NUMBERS[kind][1]):
        raise _DamagedError("an array has no type of numbers")
    return np.frombuffer(data, dtype=f"<{NUMBERS[kind]}")


def _members(content: bytes, count: int, depth: int) -> tuple[list[Any], bytes]:
    if count * TAG > len(content):
        raise _DamagedError("a cell or struct has not its members")
    values = []
    for _ in range(count):
        kind, data, content = _element(content)
        if kind != MATRIX:
            raise _DamagedError("a member is no matrix")
        values.append(_matrix(data, depth + 1)[1])
    return values, content


def _struct(content: bytes, count: int, depth: int) -> dict[str, Any] | None:
    """The fields of a struct; None for an array of structs."""
    kind, data, content = _element(content)
    lengths = _numbers(kind, data)
    _, names, content = _element(content)
    if len(lengths) != 1 or lengths[0] < 1 or len(names) % lengths[0]:
        raise _DamagedError("a struct has no names of fields")
    if count != 1:
        return None
    width = int(lengths[0])
    cut = [names[place : place + width] for place in range(0, len(names), width)]
    fields = [name.split(b"\0")[0].decode("ascii") for name in cut]
    values, _ = _members(content, len(fields), depth)
    return dict(zip(fields, values, strict=True))
