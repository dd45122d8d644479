"""Layouts of calibration sheets and boards as JSON.

A sheet lists every circle and line in mm. A board lists the parameters of its kind.
"""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from trinoc.calib.targets.abstract_target import AbstractBoard, AbstractTarget
from trinoc.calib.targets.board_set import BOARDS, BoardSet
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError
from trinoc.io.atomic import read_text
from trinoc.io.json_document import Block, parsed_json, read_document, write_document
from trinoc.numerics.tables import LARGEST_MM

PATTERN_FORMAT, PATTERN_VERSION = "trinoc-pattern", 1

_PATTERN_CONVENTIONS = (
    "mm on the sheet Z = 0; seen from the printed side X points right and Y up, the crossed"
    " lines lie along X and Y through the origin; lattice neighbours differ by one in one"
    " coordinate; inner_radius_mm is the hole of a ring, 0 for a disc."
)


def load_pattern(path: str | os.PathLike[str]) -> Pattern:
    """Read the layout of a sheet of circles from a JSON file.

    Raise `InputError`, which names file and key, for invalid content and for other boards.
    """
    target = load_target(path)
    if not isinstance(target, Pattern):
        raise InputError(
            f"{path} is not a sheet of circles, which is needed here: for other boards, or several "
            "shots of one camera, use `trinoc calibrate-rig`."
        )
    return target


def parse_pattern(document: Block, name: str) -> Pattern:
    """Create a Pattern from a JSON object with the keys "circles" and "lines".

    Raise `InputError` for invalid values.
    """
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
    """Write the layout of a sheet to a JSON file, which `load_pattern` reads."""
    document = {
        "format": PATTERN_FORMAT,
        "version": PATTERN_VERSION,
        "name": pattern.name,
        **list_figures(pattern),
        "conventions": _PATTERN_CONVENTIONS,
    }
    write_document(path, document)


def list_figures(pattern: Pattern) -> dict[str, Any]:
    """Circles and crossed lines of a pattern as the JSON object that `parse_pattern` reads."""
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
    """Value under `key` for each of `count` circles, (count,).

    The JSON value may be one number for all circles. The default is 0.
    """
    if key not in circles.values:
        return np.zeros(count)
    if isinstance(circles.values[key], list):
        return circles.numbers(key, (count,))
    return np.full(count, circles.number(key))


def _lines(document: Block) -> dict:
    """Keyword arguments of `Pattern` for the crossed lines; zero sizes if there are none."""
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


FORMAT, VERSION = "trinoc-board", 1
_CONVENTIONS = (
    "mm on the board Z = 0; seen from the printed side X points right and Y up, the origin is in"
    " the middle of the inner corners, which are ordered row by row from the top left; the top"
    " left square is dark (of a legacy ChArUco with an even number of rows it holds a marker); tags"
    " of an AprilGrid are numbered along the rows from the lower left; spacing is gap over tag;"
    " first is the number of the first marker; an inverted ChArUco is printed white for black, a"
    " mirrored one as in a mirror, its first corner at the top right; boards of a set are fixed to"
    " each other."
)


def load_target(path: str | os.PathLike[str]) -> AbstractTarget:
    """Read the layout of a calibration target from a JSON file.

    A target is a sheet of circles, a chessboard, a ChArUco board, an AprilGrid, or a set of boards
    that are fixed to each other. Raise `InputError`, which names file and key, for invalid content.
    """
    values = parsed_json(read_text(path), path)
    if isinstance(values, dict) and values.get("format") == FORMAT:
        return _target(read_document(path, FORMAT, VERSION))
    document = read_document(path, PATTERN_FORMAT, PATTERN_VERSION)
    document.expect_keys(("format", "version", "name", "circles"), ("lines", "conventions"))
    return parse_pattern(document, document.text("name"))


def save_target(target: AbstractTarget, path: str | os.PathLike[str]) -> None:
    """Write a board, or a set of boards, to a JSON file, which `load_target` reads."""
    if isinstance(target, Pattern):
        save_pattern(target, path)
        return
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": target.name}
    if isinstance(target, BoardSet):
        members = zip(target.names, target.boards, strict=True)
        document["boards"] = {
            name: {"name": board.name, **_values_of_board(board)} for name, board in members
        }
    elif isinstance(target, AbstractBoard):
        document |= _values_of_board(target)
    else:
        raise InputError(f"A {type(target).__name__} has no file: give a board or a Pattern.")
    write_document(path, {**document, "conventions": _CONVENTIONS})


def _values_of_board(board: AbstractBoard) -> dict[str, Any]:
    if isinstance(board, Pattern):
        return {board.kind: list_figures(board)}
    values = {key: getattr(board, field) for key, field in board.layout.items()}
    return {board.kind: {k: int(v) if isinstance(v, bool) else v for k, v in values.items()}}


def _target(document: Block) -> AbstractTarget:
    if "boards" not in document.values:
        # Alone, a sheet of circles has a format of its own.
        alone = [kind for kind, board in BOARDS.items() if board is not Pattern]
        document.expect_keys(("format", "version", "name"), (*alone, "conventions"))
        return _board(document, alone)
    document.expect_keys(("format", "version", "name", "boards"), ("conventions",))
    boards, kinds = {}, list(BOARDS)
    for name, block in document.block("boards").blocks():
        block.expect_keys(("name",), kinds)
        boards[name] = _board(block, kinds)
    try:
        return BoardSet(boards, name=document.text("name"))
    except InputError as error:
        raise InputError(f"{document.file}: {error}") from error


def _board(document: Block, kinds: Sequence[str]) -> AbstractBoard:
    present = [kind for kind in kinds if kind in document.values]
    if len(present) != 1:
        *others, last = kinds[1:]
        listed = " or ".join([", ".join(others), last] if others else [last])
        raise document.error(kinds[0], f"{listed} must be there, one of them: add it.")
    board, block, name = BOARDS[present[0]], document.block(present[0]), document.text("name")
    try:
        if board is Pattern:
            block.expect_keys(("circles",), ("lines",))
            return parse_pattern(block, name)
        required = [key for key in board.layout if key not in board.added_keys]
        block.expect_keys(required, board.added_keys)
        return board(**_fields(block, board), name=name)
    except InputError as error:
        if str(error).startswith(document.file):
            raise
        raise InputError(f"{document.file}: {error}") from error


def _fields(block: Block, board: type[AbstractBoard]) -> dict[str, Any]:
    """Constructor arguments of a board class that a JSON object contains.

    Values are converted to the types of the class. Raise `InputError` for a value of another type.
    """
    types: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(board)}
    values = {}
    for key, field in board.layout.items():
        if key in block.values:
            value = block.text(key) if types[field] is str else block.number(key)
            if types[field] is int and value != int(value):
                raise block.error(key, "must be a whole number: correct it.")
            values[field] = types[field](value)
    return values
