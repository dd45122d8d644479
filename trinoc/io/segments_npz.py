"""Segment files: trinoc's own npz, and the plain tables that other detectors write."""

import os
import warnings
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry import Segments
from trinoc.io.arrays_npz import read_arrays, take, write_arrays
from trinoc.io.junctions_npz import junction_arrays, junctions_of_arrays

FORMAT, VERSION = "trinoc-segments", 1
TABLE_SUFFIXES = (".npy", ".csv", ".txt")


def save_segments(segments: Segments, path: str | os.PathLike[str]) -> None:
    """Write segments as npz, whole or not at all; fields that are None are left out."""
    size = segments.image_size_px
    arrays = {
        "endpoints_px": np.asarray(segments.endpoints_px),
        "covariance_px2": np.asarray(segments.covariance_px2),
        "polarity": np.asarray(segments.polarity),
        "contrast": np.asarray(segments.contrast),
        "support": np.asarray(segments.support),
        "image_size_px": np.array([] if size is None else size, dtype=np.int64),
    }
    if segments.reasons is not None:
        arrays["reasons"] = np.asarray(segments.reasons, dtype=np.str_)
    if segments.chain is not None:
        arrays["chain"] = np.asarray(segments.chain)
    if segments.side_levels is not None:
        arrays["side_levels"] = np.asarray(segments.side_levels)
    if segments.junctions is not None:
        arrays.update(junction_arrays(segments.junctions))
    write_arrays(path, FORMAT, VERSION, arrays)


def load_segments(path: str | os.PathLike[str]) -> Segments:
    """Read segments: an npz of `save_segments`, or a table with rows x1 y1 x2 y2 in pixels.

    A table is npy, csv or txt (separated by commas or blanks; a first line of column names
    and lines that start with # are skipped). Its segments get the sigmas of
    `Segments.from_endpoints`. Raises InputError for other files, other shapes and coordinates
    that are not finite.
    """
    file = Path(path)
    if file.suffix.lower() in TABLE_SUFFIXES:
        try:
            return Segments.from_endpoints(_table(file))
        except InputError as error:
            raise _in_file(file, error) from error
    arrays = read_arrays(file, FORMAT, VERSION)
    size = take(arrays, "image_size_px", file)
    try:
        # Checks the ends; everything else is then taken from the file.
        plain = Segments.from_endpoints(take(arrays, "endpoints_px", file))
    except InputError as error:
        raise _in_file(file, error) from error
    covariance = np.asarray(take(arrays, "covariance_px2", file), dtype=np.float64)
    if covariance.shape != (len(plain), 4, 4) or not np.isfinite(covariance).all():
        raise InputError(
            f'{file}: "covariance_px2" must be ({len(plain)}, 4, 4) and finite: '
            "write the file again."
        )
    return Segments(
        plain.endpoints_px,
        covariance,
        _column(arrays, "polarity", file, len(plain)).astype(np.int64),
        _column(arrays, "contrast", file, len(plain)).astype(np.float64),
        _column(arrays, "support", file, len(plain)).astype(np.int64),
        (int(size[0]), int(size[1])) if size.size else None,
        _column(arrays, "reasons", file, len(plain)) if "reasons" in arrays else None,
        _column(arrays, "chain", file, len(plain)).astype(np.int64) if "chain" in arrays else None,
        junctions_of_arrays(arrays, file, len(plain)),
        _side_levels(arrays, file, len(plain)) if "side_levels" in arrays else None,
    )


def _in_file(file: Path, error: InputError) -> InputError:
    text = str(error)
    return error if text.startswith(str(file)) else InputError(f"{file}: {text}")


def _side_levels(arrays: dict[str, np.ndarray], file: Path, length: int) -> np.ndarray:
    levels = np.asarray(take(arrays, "side_levels", file), dtype=np.float64)
    if levels.shape != (length, 2):
        raise InputError(
            f'{file}: "side_levels" has shape {levels.shape}, but there are {length} segments with '
            "two sides: write the file again."
        )
    return levels


def _column(arrays: dict[str, np.ndarray], name: str, file: Path, length: int) -> np.ndarray:
    column = take(arrays, name, file)
    if column.shape != (length,):
        raise InputError(
            f'{file}: "{name}" has shape {column.shape}, but there are {length} segments: '
            "write the file again."
        )
    return column


def _table(file: Path) -> np.ndarray:
    try:
        if file.suffix.lower() == ".npy":
            array = np.load(file, allow_pickle=False)
        else:
            array = _text_table(file.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(
            f"{file} is not a table of numbers: give rows of x1 y1 x2 y2 in pixels."
        ) from error
    if not np.issubdtype(array.dtype, np.number):
        raise InputError(f"{file} is not a table of numbers: give rows of x1 y1 x2 y2 in pixels.")
    return array


def _text_table(text: str) -> np.ndarray:
    lines = [line for line in text.replace(",", " ").splitlines() if line.strip()]
    if lines and not _is_numbers(lines[0]) and not lines[0].lstrip().startswith("#"):
        lines = lines[1:]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*input contained no data")
        return np.loadtxt(lines, ndmin=2)


def _is_numbers(line: str) -> bool:
    try:
        [float(word) for word in line.split()]
    except ValueError:
        return False
    return True
