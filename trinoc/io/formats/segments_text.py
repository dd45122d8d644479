"""2-D segments in the text formats of other detectors: a row for each, beginning x1 y1 x2 y2.

LSD's command line adds width, precision and -log10 of the false alarms (7 columns). ELSED may add a
score (5 columns). LIMAP's segments_<image>.txt begins with the number of rows. In all formats (0,
0) is the centre of the top-left pixel. Only the ends are read.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from trinoc.errors import InputError
from trinoc.geometry.segments import Segments
from trinoc.io.atomic import read_text, write_text
from trinoc.io.formats.format import COVARIANCE, DETAILS, Format, Lenses


def write_rows(segments: Segments, path: Path, unit_mm: float) -> None:
    """Write one row x1 y1 x2 y2 in px for each segment."""
    write_text(path, "".join(_rows(segments)))


def write_counted(segments: Segments, path: Path, unit_mm: float) -> None:
    """Write the number of segments, then one row x1 y1 x2 y2 in px for each segment."""
    write_text(path, "".join([f"{len(segments)}\n", *_rows(segments)]))


def read_rows(*columns: int) -> Callable[[Path, float, Lenses | None], Segments]:
    """Return a reader of text files whose rows have one of the numbers of columns in `columns`.

    The first four columns are x1 y1 x2 y2 in px; further columns are ignored.
    """

    def read(path: Path, unit_mm: float, lenses: Lenses | None) -> Segments:
        return _segments(read_text(path).splitlines(), path, columns, 1)

    return read


def read_counted(path: Path, unit_mm: float, lenses: Lenses | None) -> Segments:
    """Read the number of segments in the first line, then one row x1 y1 x2 y2 for each segment."""
    first, *lines = read_text(path).splitlines() or [""]
    segments = _segments(lines, path, (4,), 2)
    if first.strip() != str(len(segments)):
        raise InputError(
            f"{path}, line 1, must be the number of segments, {len(segments)}, but is "
            f'"{first.strip()[:20]}": give a file of LIMAP.'
        )
    return segments


def _rows(segments: Segments) -> list[str]:
    ends = np.asarray(segments.endpoints_px, dtype=np.float64).reshape(-1, 4)
    return [" ".join(map(repr, row)) + "\n" for row in ends.tolist()]


def _segments(lines: list[str], path: Path, columns: tuple[int, ...], start: int) -> Segments:
    rows = []
    for number, line in enumerate(lines, start):
        fields = line.replace(",", " ").split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in fields]
        except ValueError:
            row = []
        if len(row) not in columns:
            raise InputError(
                f"{path}, line {number}, must be {' or '.join(map(str, columns))} numbers, x1 y1 "
                "x2 y2 first: correct it."
            )
        rows.append(row[:4])
    try:
        return Segments.from_endpoints(np.array(rows).reshape(-1, 4))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


lsd = Format(
    name="lsd",
    title="LSD's text",
    holds=("segments",),
    reads=("segments",),
    endings=(".txt",),
    unit_mm=None,
    unit_is_fixed=True,
    frames="pixel (0, 0) is the centre of the top-left pixel",
    loses=(COVARIANCE, DETAILS),
    write=write_rows,
    read=read_rows(4, 5, 7),
)
elsed = replace(lsd, name="elsed", title="ELSED's text", read=read_rows(4, 5))
limap_segments = replace(
    lsd, name="limap-segments", title="LIMAP's segments", write=write_counted, read=read_counted
)
