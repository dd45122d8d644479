"""Layouts of sheets as JSON: every circle and line in mm, whatever made the grid."""

import os
from typing import Any

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io.json_document import Block, read_document, write_document
from trinoc.numerics.table_checks import LARGEST_MM

FORMAT, VERSION = "trinoc-pattern", 1

_CONVENTIONS = (
    "mm on the sheet Z = 0; seen from the printed side X points right and Y up, the crossed"
    " lines lie along X and Y through the origin; lattice neighbours differ by one in one"
    " coordinate; inner_radius_mm is the hole of a ring, 0 for a disc."
)


def load_pattern(path: str | os.PathLike[str]) -> Pattern:
    """Read a layout. Raises InputError, in one sentence with file and key."""
    document = read_document(path, FORMAT, VERSION)
    document.expect_keys(("format", "version", "name", "circles"), ("lines", "conventions"))
    return parse_pattern(document, document.text("name"))


def parse_pattern(document: Block, name: str) -> Pattern:
    """The sheet whose circles and lines an object holds. Raises InputError."""
    circles = document.block("circles")
    circles.expect_keys(("centres_mm", "radius_mm", "lattice"), ("inner_radius_mm",))
    centres_mm = circles.numbers("centres_mm", (None, 2))
    lattice = circles.numbers("lattice", (len(centres_mm), 2))
    if np.any(lattice != np.rint(lattice)) or np.any(np.abs(lattice) > LARGEST_MM):
        raise circles.error("lattice", "must hold whole numbers.")
    try:
        return Pattern(
            name=name,
            centres_mm=centres_mm,
            radius_mm=_per_circle(circles, "radius_mm", len(centres_mm)),
            inner_radius_mm=_per_circle(circles, "inner_radius_mm", len(centres_mm)),
            lattice=lattice.astype(np.int64),
            **_lines(document),
        )
    except InputError as error:
        if str(error).startswith(document.file):
            raise
        raise InputError(f"{document.file}: {error}") from error


def save_pattern(pattern: Pattern, path: str | os.PathLike[str]) -> None:
    """Write a layout; `load_pattern` gives the same pattern back."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": pattern.name,
        **list_figures(pattern),
        "conventions": _CONVENTIONS,
    }
    write_document(path, document)


def list_figures(pattern: Pattern) -> dict[str, Any]:
    """Its circles and lines, as `pattern_of` reads them."""
    return {
        "circles": {
            "centres_mm": pattern.centres_mm.tolist(),
            "radius_mm": pattern.radius_mm.tolist(),
            "inner_radius_mm": pattern.inner_radius_mm.tolist(),
            "lattice": pattern.lattice.tolist(),
        },
        "lines": {
            "width_mm": pattern.line_width_mm,
            "half_length_mm": list(pattern.line_half_length_mm),
            "style": pattern.line_style,
            "gap_mm": pattern.line_gap_mm,
        },
    }


def _per_circle(circles: Block, key: str, count: int) -> np.ndarray:
    """One number for each circle; a single number stands for all, a missing key for 0."""
    if key not in circles.values:
        return np.zeros(count)
    if isinstance(circles.values[key], list):
        return circles.numbers(key, (count,))
    return np.full(count, circles.number(key))


def _lines(document: Block) -> dict:
    """The fields of the crossed lines; a layout without them has none."""
    if "lines" not in document.values:
        return {
            "line_width_mm": 0.0,
            "line_half_length_mm": (0.0, 0.0),
            "line_style": "stop",
            "line_gap_mm": 0.0,
        }
    lines = document.block("lines")
    lines.expect_keys(("width_mm", "half_length_mm"), ("style", "gap_mm"))
    half_x_mm, half_y_mm = lines.numbers("half_length_mm", (2,))
    return {
        "line_width_mm": lines.number("width_mm"),
        "line_half_length_mm": (float(half_x_mm), float(half_y_mm)),
        "line_style": lines.text("style") if "style" in lines.values else "stop",
        "line_gap_mm": lines.number("gap_mm") if "gap_mm" in lines.values else 0.0,
    }
