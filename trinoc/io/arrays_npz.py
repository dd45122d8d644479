"""npz files with a format name and a version, read safely.

A small file can state, and unpack to, thousands of times its size. So the size that the header of
an array states is compared with the file and with a limit before memory is reserved.
"""

import ast
import math
import os
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from trinoc.errors import InputError, expect_path
from trinoc.io.atomic import atomic_write, has_half_characters

# Unpacked, all arrays together: matches of half a million tracks.
MOST_BYTES = 2**30
# NumPy's own limit for a header that is not trusted.
LONGEST_HEADER = 10_000
# Text, numbers and truth values; no objects, whose loading runs code, and no records.
_KINDS = "biufcU"


def write_arrays(
    path: str | os.PathLike[str],
    format_name: str,
    version: int,
    arrays: dict[str, np.ndarray],
    *,
    compressed: bool = True,
) -> None:
    """Write arrays to an npz file, together with a format name and a version.

    The file appears complete or not at all. Raise `InputError` for array names or strings with
    characters that cannot be written.
    """
    for name, array in arrays.items():
        texts = array.ravel().tolist() if array.dtype.kind == "U" else ()
        # A zip file cuts names at a zero; half a character cannot be printed.
        if not name.isprintable() or has_half_characters("".join(texts)):
            raise InputError(
                f"{path} was not written: {name!r} contains an invalid character: correct "
                "this text."
            )
    named: dict[str, Any] = {"format": np.array(format_name), "version": np.array(version)}
    named.update(arrays)
    with atomic_write(path) as file:
        (np.savez_compressed if compressed else np.savez)(file, **named)


def read_arrays(
    path: str | os.PathLike[str], format_name: str, version: int
) -> dict[str, np.ndarray]:
    """Read the arrays of a file of `write_arrays`, keyed by name, without format name and version.

    Raise `InputError` if the file is missing, damaged or too large, or has another format or
    version.
    """
    expect_path(path)
    file = Path(path)
    arrays = _arrays(file)
    stated = _one(arrays.pop("format", None))
    if stated != format_name:
        raise InputError(
            f'{file} has the format "{stated}", but "{format_name}" is needed: give another file.'
        )
    stated_version = _one(arrays.pop("version", None))
    if stated_version != str(version):
        raise InputError(
            f"{file} has version {stated_version or 'missing'} of {format_name}, but this trinoc "
            f"reads version {version}: update trinoc or write the file again."
        )
    return arrays


def format_of_arrays(path: str | os.PathLike[str]) -> str:
    """Format name in a file of `write_arrays`; empty if the file contains none.

    Raise `InputError` for an unreadable file.
    """
    return _one(_arrays(Path(path), ("format",)).get("format"))


def load_array(path: Path) -> np.ndarray:
    """Read the array of an npy file.

    Raise ValueError if the file is damaged, and OSError if it cannot be opened.
    """
    with path.open("rb") as file:
        return _array(file, os.fstat(file.fileno()).st_size)


def _one(array: np.ndarray | None) -> str:
    """Convert an array of one word or one whole number to a string; "" for other arrays."""
    if array is None or array.ndim != 0 or array.dtype.kind not in "iuU":
        return ""
    return str(array)[:60]


def _arrays(file: Path, only: tuple[str, ...] | None = None) -> dict[str, np.ndarray]:
    try:
        with zipfile.ZipFile(file) as archive:
            members = [entry for entry in archive.infolist() if entry.filename.endswith(".npy")]
            if sum(entry.file_size for entry in members) > MOST_BYTES:
                raise InputError(
                    f"{file} unpacks to more than {MOST_BYTES / 1e9:.1f} GB, which is too "
                    "large for a file of trinoc: give another file."
                )
            arrays = {}
            for entry in members:
                name = entry.filename.removesuffix(".npy")
                if only is None or name in only:
                    with archive.open(entry) as member:
                        arrays[name] = _array(member, entry.file_size)
            return arrays
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except InputError:
        raise
    except (
        *(OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error),
        # Encrypted members, methods of compression that Python lacks.
        *(RuntimeError, NotImplementedError),
    ) as error:
        raise InputError(
            f"{file} is not a readable npz file: give a file that trinoc wrote, or write it again."
        ) from error


class _CountingStream:
    """A binary stream that counts the bytes read from it, in `taken`."""

    def __init__(self, stream: Any) -> None:
        self.stream, self.taken = stream, 0

    def read(self, count: int) -> bytes:
        content = self.stream.read(count)
        self.taken += len(content)
        return content


def _array(stream: Any, size: int) -> np.ndarray:
    """Read the array of an npy stream of `size` bytes. Raise ValueError if it is damaged."""
    counter = _CountingStream(stream)
    shape, fortran, dtype = _header(counter)
    # Products of Python's whole numbers do not overflow.
    byte_count = math.prod(shape) * dtype.itemsize
    if dtype.kind not in _KINDS or byte_count != size - counter.taken or size > MOST_BYTES:
        raise ValueError("The header does not describe the data after it.")
    if any(side < 0 for side in shape) or dtype.itemsize == 0:
        raise ValueError("The array has an impossible shape or type.")
    content = bytearray(stream.read(byte_count))
    if len(content) != byte_count:
        raise ValueError("The array ends early.")
    if stream.read(1):  # at the end, zipfile compares the check sum
        raise ValueError("The file has data after the end of the array.")
    flat = np.frombuffer(content, dtype).astype(dtype.newbyteorder("="), copy=False)
    if dtype.kind == "U":
        _expect_characters(flat)
    return flat.reshape(shape, order="F" if fortran else "C")


def _header(stream: _CountingStream) -> tuple[tuple[int, ...], bool, np.dtype]:
    """Read the header of an npy stream: (shape, is in Fortran order, dtype).

    Raise ValueError for a damaged header. NumPy's own function would emit warnings, and raise other
    exceptions.
    """
    start = stream.read(8)
    if start[:6] != npy.MAGIC_PREFIX or start[6:] not in (b"\1\0", b"\2\0"):
        raise ValueError("This is no npy of version 1 or 2.")
    form = "<H" if start[6] == 1 else "<I"
    try:
        (length,) = struct.unpack(form, stream.read(struct.calcsize(form)))
        if length > LONGEST_HEADER:
            raise ValueError("The header is too long.")
        header = ast.literal_eval(stream.read(length).decode("latin-1").strip())
        shape, fortran, kind = header["shape"], header["fortran_order"], header["descr"]
        dtype = np.dtype(kind) if isinstance(kind, str) else None
    except Exception as error:  # it is a text that Python parses, in whatever way it fails
        raise ValueError("The header is damaged.") from error
    is_shape = isinstance(shape, tuple) and all(type(side) is int for side in shape)
    if not is_shape or dtype is None or not isinstance(fortran, bool):
        raise ValueError("The header does not describe an array.")
    return shape, fortran, dtype


def _expect_characters(texts: np.ndarray) -> None:
    """Raise ValueError if an array of strings contains codes that are not characters."""
    codes = texts.view(np.uint32)
    if ((codes > 0x10FFFF) | ((codes >= 0xD800) & (codes < 0xE000))).any():
        raise ValueError("A text contains an invalid character.")
