"""Meaning of column names in tables of 2-D segments and 3-D edges.

Names are compared in lower case, without punctuation and without the unit px: X1, x_1, "x1 [px]"
and x1_px are one name.
"""

import itertools
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError

_AXES = {"x": ("x", "u", "col", "column"), "y": ("y", "v", "row"), "z": ("z",)}
_ENDS = {
    "0": ("0", "p0", "pt0"),
    "1": ("1", "p1", "pt1"),
    "2": ("2", "p2", "pt2"),
    "first": ("a", "s", "start", "begin", "first", "from"),
    "last": ("b", "e", "end", "stop", "last", "to"),
    "middle": ("m", "mid", "middle", "c", "center", "centre", "ctr"),
}
_DIRECTIONS = ("d", "delta", "dir", "direction")
_EXTENTS = {"full": ("full", "whole"), "half": ("half",)}
_ANGLES = ("angle", "theta", "orientation", "direction")
_ANGLE_UNITS = {"deg": ("deg", "degree", "degrees"), "rad": ("rad", "radian", "radians")}

# What detectors and tables add to a segment and its ends do not need.
_DETECTOR_COLUMNS = (
    "width precision prec p nfa lognfa score response confidence conf probability prob strength "
    "gradient contrast support numof size rho id idx index nr no number label class "
    "classid"
)
LEFT_OUT = frozenset(_DETECTOR_COLUMNS.split())
KNOWN_COLUMNS = (
    "x1 y1 x2 y2; row1 col1 row2 col2; xm ym full_dx full_dy, from end to end; xm ym half_dx "
    "half_dy, from the middle to an end; xm ym dx dy length; or xm ym length angle_deg (or "
    "angle_rad)"
)


def _known_names() -> dict[str, str]:
    """Meaning of each accepted column name, for example "startx" -> "x first"."""
    meanings = {"length": "length", "len": "length", "linelength": "length"}
    for axis, spellings in _AXES.items():
        for word, (end, marks) in itertools.product(spellings, _ENDS.items()):
            for mark in marks:
                meanings |= {word + mark: f"{axis} {end}", mark + word: f"{axis} {end}"}
        for word, direction in itertools.product(spellings, _DIRECTIONS):
            for name in (direction + word, word + direction):
                meanings[name] = f"{axis} vector"
                for extent, marks in _EXTENTS.items():
                    for mark in marks:
                        meanings |= dict.fromkeys((name + mark, mark + name), f"{axis} {extent}")
    for letter, axis in (("r", "y"), ("c", "x")):
        meanings |= {f"{letter}{k}": f"{axis} {k}" for k in range(3)}
        meanings[f"d{letter}"] = f"{axis} vector"
    for word in _ANGLES:
        meanings[word] = "angle"
        for unit, marks in _ANGLE_UNITS.items():
            meanings |= {word + mark: f"angle {unit}" for mark in marks}
    return meanings


_MEANINGS = _known_names()
_ENDS_OF_SEGMENT = ("x first", "y first", "x last", "y last")
_MIDDLE = ("x middle", "y middle")


def names_of_line(line: str) -> list[str]:
    """Column names in a heading line, without quotes.

    The separator is a semicolon, a comma or a tab; without these, blanks.
    """
    separator = next((sign for sign in ";,\t" if sign in line), None)
    names = [name.strip(" \t\"'") for name in line.split(separator)]
    while names and not names[-1]:
        names.pop()
    return names


def names_of_comment(comment: str, count: int) -> list[str] | None:
    """Names of `count` columns in a comment line; None if the comment is another text.

    np.savetxt, for example, writes such comments. At least two of the names must be coordinates of
    ends or of the middle of a segment.
    """
    tokens = [word for word in re.split(r"[\s,;]+", comment) if word and not word.endswith(":")]
    for names in (tokens, [word for word in tokens if _meaning(word) or _is_left_out(word)]):
        coordinates = [name for name in names if (_meaning(name) or "")[2:] in _ENDS]
        if len(names) == count and len(coordinates) > 1:
            return names
    return None


def ends_of_columns(
    names: Sequence[str], rows: Float[np.ndarray, "n c"], where: str
) -> Float[np.ndarray, "n 4"]:
    """Compute end points x1 y1 x2 y2 of segments from a table with named columns.

    Parameters
    ----------
    names : sequence of str
        Column names.
    rows : (n, c)
        Numbers of the table, one row for each segment.
    where : str
        File and line of the heading, for messages.

    Returns
    -------
    (n, 4)
        End points x1 y1 x2 y2, px.

    Raises
    ------
    InputError
        If the columns do not determine the ends, or the meaning of a column is unknown.
    """
    columns = _columns_of(names, rows, where)
    if any(key in columns for key in _ENDS_OF_SEGMENT):
        needed = _ENDS_OF_SEGMENT
    else:
        needed = (*_MIDDLE, *_needed_beside_middle(columns, where))
    if not all(key in columns for key in needed):
        raise InputError(
            f"{where}, names the columns {', '.join(names)}, which do not give the ends of a "
            f"segment: name them {KNOWN_COLUMNS}."
        )
    unknown = [
        name
        for name in names
        if name
        and not _is_left_out(name)
        and ((meaning := _meaning(name)) is None or meaning.startswith("z"))
    ]
    if unknown:
        raise InputError(
            f'{where}, names a column "{unknown[0]}" that trinoc does not know: remove it, or name '
            f"the columns {KNOWN_COLUMNS}."
        )
    if needed == _ENDS_OF_SEGMENT:
        return np.stack([columns[key] for key in needed], axis=1)
    middle = np.stack([columns[key] for key in _MIDDLE], axis=1)
    half = _half_vector(columns, needed)
    return np.hstack([middle - half, middle + half])


def order_in_space(
    names: Sequence[str], rows: Float[np.ndarray, "n c"], where: str
) -> Float[np.ndarray, "n c"]:
    """Arrange the columns of a table of 3-D points or edges as x y z, or x1 y1 z1 x2 y2 z2.

    `names` are the column names, in any order. Raise `InputError` for other names. `where` is file
    and line of the heading, for messages.
    """
    if len(names) == 3:
        columns = {_plain(name): column for name, column in zip(names, rows.T, strict=True)}
        needed = ("x", "y", "z")
    else:
        columns = _columns_of(names, rows, where)
        needed = tuple(f"{axis} {end}" for end in ("first", "last") for axis in "xyz")
    if set(columns) != set(needed) or len(names) != len(needed):
        raise InputError(
            f"{where}, names the columns {', '.join(names)}: name them x1 y1 z1 x2 y2 z2 for "
            "edges, or x y z for points, in any order."
        )
    return np.stack([columns[key] for key in needed], axis=1)


def _needed_beside_middle(columns: Mapping[str, np.ndarray], where: str) -> tuple[str, ...]:
    """Names of the columns that, together with the middle, determine the ends of a segment.

    Raise `InputError` if the meaning of dx, dy or the unit of an angle is unclear.
    """
    alternatives = (
        ("x full", "y full"),
        ("x half", "y half"),
        ("x vector", "y vector", "length"),
        ("length", "angle deg"),
        ("length", "angle rad"),
    )
    complete = [keys for keys in alternatives if all(key in columns for key in keys)]
    has_middle = all(key in columns for key in _MIDDLE)
    if not complete and has_middle and "x vector" in columns:
        raise InputError(
            f"{where}, does not state whether dx, dy are measured from end to end or from the "
            "middle to an end: name them full_dx, full_dy or half_dx, half_dy, or add a column "
            "length."
        )
    if not complete and has_middle and "angle" in columns:
        raise InputError(
            f"{where}, does not state the unit of the angle: name the column angle_deg or "
            "angle_rad."
        )
    return complete[0] if complete else ("length", "angle deg")


def _half_vector(
    columns: Mapping[str, np.ndarray], needed: Sequence[str]
) -> Float[np.ndarray, "n 2"]:
    """Vector from the middle of each segment to its second end, (n, 2) px.

    `needed` are the column names of `_needed_beside_middle`.
    """
    if "x full" in needed:
        return np.stack([columns["x full"], columns["y full"]], axis=1) / 2
    if "x half" in needed:
        return np.stack([columns["x half"], columns["y half"]], axis=1)
    if "x vector" in needed:
        vector = np.stack([columns["x vector"], columns["y vector"]], axis=1)
        direction = vector / np.linalg.norm(vector, axis=1, keepdims=True)
    else:
        in_degrees = "angle deg" in needed
        angle = np.deg2rad(columns["angle deg"]) if in_degrees else columns["angle rad"]
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return direction * columns["length"][:, None] / 2


def _columns_of(
    names: Sequence[str], rows: Float[np.ndarray, "n c"], where: str
) -> dict[str, np.ndarray]:
    """Columns keyed by meaning, such as "x first"; columns of unknown meaning are left out.

    Ends with the numbers 0 and 1, or 1 and 2, are called "first" and "last". Raise `InputError` for
    two columns of one meaning.
    """
    if rows.shape[1] != len(names):
        raise InputError(
            f"{where}, names {len(names)} columns, but the rows have {rows.shape[1]} numbers: "
            "name each column."
        )
    meanings = [_meaning(name) for name in names]
    begins_with_0 = any(meaning and meaning.endswith(" 0") for meaning in meanings)
    ends = ("0", "1") if begins_with_0 else ("1", "2")
    columns: dict[str, np.ndarray] = {}
    name_of: dict[str, str] = {}
    for name, meaning, column in zip(names, meanings, rows.T, strict=True):
        if meaning is None:
            continue
        axis, _, end = meaning.partition(" ")
        if end in ends:
            meaning = f"{axis} {('first', 'last')[ends.index(end)]}"
        if meaning in columns or (begins_with_0 and end == "2"):
            other = name_of.get(meaning, next(iter(name_of.values()), name))
            raise InputError(
                f'{where}, has columns "{other}" and "{name}", which may be the same quantity: '
                f"keep four columns {KNOWN_COLUMNS}."
            )
        columns[meaning], name_of[meaning] = column, name
    return columns


def _plain(name: str) -> str:
    name = name.lower().replace("\N{DEGREE SIGN}", "deg")
    return re.sub(r"point|pixels?|px$", "", re.sub(r"[^a-z0-9]", "", name))


def _meaning(name: str) -> str | None:
    return _MEANINGS.get(_plain(name))


def _is_left_out(name: str) -> bool:
    return _plain(name) in LEFT_OUT
