"""Segments from files: trinoc's npz, and tables of other detectors."""

import os
from pathlib import Path

import numpy as np

from trinoc.errors import InputError, expect_path
from trinoc.geometry.segments import Segments
from trinoc.io.arrays_npz import MOST_BYTES, load_array
from trinoc.io.atomic import read_text
from trinoc.io.column_names import ends_of_columns, names_of_comment, names_of_line
from trinoc.io.tables_npz import load_npz
from trinoc.numerics.tables import LARGEST_PX

TABLE_SUFFIXES = (".npy", ".csv", ".txt")

_REMEDY = "give rows of x1 y1 x2 y2 in pixels"


def load_segments(path: str | os.PathLike[str]) -> Segments:
    """Read segments from an npz file of `save`, or from a table of another detector.

    Parameters
    ----------
    path : path
        An npz file, or a table: npy, csv or txt with rows x1 y1 x2 y2 in pixels.

    Returns
    -------
    Segments
        Segments of a table have the default sigmas of `Segments.from_endpoints`.

    Raises
    ------
    InputError
        If the file or a column name is unknown, or a value is invalid, for example not finite. The
        message names the field and the first invalid row.

    Notes
    -----
    In a text table, commas, semicolons or blanks separate numbers, and lines that begin with `#`
    are skipped. A first line, or a comment above the numbers, may name the columns. Then they may
    have any order and be of these kinds:

    - ends `x1 y1 x2 y2`; also `start_x`, `x0 y0 x1 y1`, `row1 col1 row2 col2` and similar;
    - the middle `xm ym`, with the vector `full_dx full_dy` from end to end, or `half_dx half_dy`
      from the middle to the second end;
    - the middle, with a direction `dx dy` of any length and the `length` from end to end;
    - the middle, with `length` and `angle_deg` or `angle_rad`, from x toward y, which points down.

    Other columns of detectors, such as width, score and nfa, are ignored.
    """
    expect_path(path)
    file = Path(path)
    if file.suffix.lower() not in TABLE_SUFFIXES:
        return load_npz(Segments, file)
    try:
        segments = Segments.from_endpoints(read_table(file))
    except InputError as error:
        text = str(error)
        raise error if text.startswith(str(file)) else InputError(f"{file}: {text}") from error
    ends = np.abs(np.asarray(segments.endpoints_px))
    if len(ends) and ends.max() <= 1:
        raise InputError(
            f"{file} has no coordinate above 1, so the coordinates may be relative to the size of "
            f"the picture: {_REMEDY}."
        )
    far = np.flatnonzero((ends > LARGEST_PX).any(axis=(1, 2)))
    if len(far):
        raise InputError(
            f"{file}: segment {far[0]} has a coordinate of {ends[far[0]].max():g} px, outside any "
            "picture: give ends in pixels of the picture."
        )
    return segments


def read_table(file: Path) -> np.ndarray:
    """Read the numbers (n, c) of a table file.

    Raise `InputError`, which names the line, for other content.
    """
    if file.suffix.lower() != ".npy":
        return _text_table(read_text(file, MOST_BYTES), file)
    try:
        array = load_array(file)
    except FileNotFoundError as error:
        raise InputError(f"{file} does not exist: check the name.") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{file} is not a table of numbers: {_REMEDY}.") from error
    if array.dtype.kind not in "iuf":
        raise InputError(f"{file} is not a table of numbers, but of {array.dtype}: {_REMEDY}.")
    return array.astype(np.float64)


def _text_table(text: str, file: Path) -> np.ndarray:
    """Numbers of a text table: x1 y1 x2 y2 if the columns have names, else all columns."""
    rows: list[list[float]] = []
    heading: tuple[int, str] | None = None
    comments: list[tuple[int, str]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        line, _, comment = line.partition("#")
        if comment and not line.strip() and not rows:
            comments.append((number, comment))
        line = line.strip()
        if not line:
            continue
        row = _numbers(_words(line)) or None
        if (row is None or len(row) != 4) and _has_decimal_commas(line):
            raise InputError(
                f"{file}, line {number}, has numbers with a decimal comma: write them with a point."
            )
        if row is None and heading is None and not rows and _is_names(line):
            heading = number, line
        elif row is None:
            raise InputError(f"{file}, line {number}, is not a table of numbers: {_REMEDY}.")
        elif rows and len(row) != len(rows[0]):
            raise InputError(
                f"{file}, line {number}, has {len(row)} numbers, but other lines have "
                f"{len(rows[0])}, so the file is not a table of numbers: {_REMEDY}."
            )
        else:
            rows.append(row)
    if heading is not None:
        number, names = heading[0], names_of_line(heading[1])
        table = np.array(rows) if rows else np.zeros((0, len(names)))
        return ends_of_columns(names, table, f"{file}, line {number}")
    table = np.array(rows) if rows else np.zeros((0, 4))
    for number, comment in reversed(comments):
        names = names_of_comment(comment, table.shape[1])
        if names is not None:
            return ends_of_columns(names, table, f"{file}, line {number}")
    return table


def _words(line: str) -> list[str]:
    return line.replace(",", " ").replace(";", " ").split()


def _numbers(fields: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in fields]
    except ValueError:
        return None


def _is_names(line: str) -> bool:
    """True for a line without any number, such as x1,y1,x2,y2."""
    return all(_numbers([word]) is None for word in _words(line))


def _has_decimal_commas(line: str) -> bool:
    """True for four numbers with a decimal comma, separated by semicolons or blanks."""
    fields = line.replace(";", " ").split()
    parts = [word.split(",") for word in fields]
    return (
        len(fields) == 4
        and all(
            len(pair) <= 2 and all(part.lstrip("+-").isdigit() for part in pair) for pair in parts
        )
        and any(len(pair) == 2 for pair in parts)
    )
