"""Boards of squares as JSON, beside the layouts of sheets of circles."""

import os
from typing import Any

from trinoc.calib import AbstractTarget, AprilGrid, BoardSet, Charuco, Chessboard, Pattern
from trinoc.errors import InputError
from trinoc.io import pattern_json
from trinoc.io.json_document import Block, read_document, write_document
from trinoc.io.json_text import parsed_json
from trinoc.io.whole_files import read_text

FORMAT, VERSION = "trinoc-board", 1
# A sheet of circles alone has a format of its own.
_KINDS = ("chessboard", "charuco", "aprilgrid", "sheet")

_CONVENTIONS = (
    "mm on the board Z = 0; seen from the printed side X points right and Y up, the origin is in"
    " the middle of the inner corners, which are ordered row by row from the top left; the top"
    " left square is dark (of a legacy ChArUco with an even number of rows it holds a marker); tags"
    " of an AprilGrid are numbered along the rows from the lower left; spacing is gap over tag;"
    " first is the number of the first marker; boards of a set are fixed to each other."
)


def load_target(path: str | os.PathLike[str]) -> AbstractTarget:
    """Read a layout of a sheet of circles, a chessboard, a ChArUco board or an AprilGrid, or of a
    set of them that are fixed to each other.

    Raises InputError.
    """
    values = parsed_json(read_text(path), path)
    if isinstance(values, dict) and values.get("format") == FORMAT:
        return _target(read_document(path, FORMAT, VERSION))
    return pattern_json.load_pattern(path)


def save_target(target: AbstractTarget, path: str | os.PathLike[str]) -> None:
    """Write a board, or a set of them; `load_target` gives the same one back."""
    if isinstance(target, Pattern):
        pattern_json.save_pattern(target, path)
        return
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": target.name}
    if isinstance(target, BoardSet):
        members = zip(target.names, target.boards, strict=True)
        document["boards"] = {
            name: {"name": board.name, **_figures(board)} for name, board in members
        }
    else:
        document |= _figures(target)
    write_document(path, {**document, "conventions": _CONVENTIONS})


def _figures(target: AbstractTarget) -> dict[str, Any]:
    match target:
        case Pattern():
            return {"sheet": pattern_json.figures_of(target)}
        case Chessboard():
            return {
                "chessboard": {
                    "inner_rows": target.rows,
                    "inner_columns": target.columns,
                    "square_mm": target.square_mm,
                }
            }
        case Charuco():
            return {
                "charuco": {
                    "rows": target.rows,
                    "columns": target.columns,
                    "square_mm": target.square_mm,
                    "marker_mm": target.marker_mm,
                    "dictionary": target.dictionary,
                    "legacy": int(target.legacy),
                    "first": target.first,
                }
            }
        case AprilGrid():
            return {
                "aprilgrid": {
                    "rows": target.rows,
                    "columns": target.columns,
                    "tag_mm": target.tag_mm,
                    "spacing": target.spacing,
                    "dictionary": target.dictionary,
                    "border": target.border,
                    "first": target.first,
                }
            }
    raise InputError(f"A {type(target).__name__} has no file: give a board or a Pattern.")


def _target(document: Block) -> AbstractTarget:
    if "boards" not in document.values:
        document.expect_keys(("format", "version", "name"), (*_KINDS[:-1], "conventions"))
        return _board(document, _KINDS[:-1])
    document.expect_keys(("format", "version", "name", "boards"), ("conventions",))
    boards = {}
    for name, block in document.block("boards").blocks():
        block.expect_keys(("name",), _KINDS)
        boards[name] = _board(block, _KINDS)
    try:
        return BoardSet(boards, name=document.text("name"))
    except InputError as error:
        raise InputError(f"{document.file}: {error}") from error


def _board(document: Block, kinds: tuple[str, ...]) -> AbstractTarget:
    given = [kind for kind in kinds if kind in document.values]
    if len(given) != 1:
        *others, last = kinds[1:]
        listed = " or ".join([", ".join(others), last] if others else [last])
        raise document.error(kinds[0], f"{listed} must be there, one of them: add it.")
    block, name = document.block(given[0]), document.text("name")
    try:
        return _of_kind(given[0], block, name)
    except InputError as error:
        if str(error).startswith(document.file):
            raise
        raise InputError(f"{document.file}: {error}") from error


def _of_kind(kind: str, block: Block, name: str) -> AbstractTarget:
    match kind:
        case "sheet":
            block.expect_keys(("circles",), ("lines",))
            return pattern_json.pattern_of(block, name)
        case "chessboard":
            block.expect_keys(("inner_rows", "inner_columns", "square_mm"))
            return Chessboard(
                rows=_count(block, "inner_rows"),
                columns=_count(block, "inner_columns"),
                square_mm=block.number("square_mm"),
                name=name,
            )
        case "aprilgrid":
            block.expect_keys(
                ("rows", "columns", "tag_mm", "spacing", "dictionary"), ("border", "first")
            )
            return AprilGrid(
                rows=_count(block, "rows"),
                columns=_count(block, "columns"),
                tag_mm=block.number("tag_mm"),
                spacing=block.number("spacing"),
                dictionary=block.text("dictionary"),
                border=_count(block, "border") if "border" in block.values else 2,
                first=_first(block),
                name=name,
            )
    block.expect_keys(
        ("rows", "columns", "square_mm", "marker_mm", "dictionary"), ("legacy", "first")
    )
    return Charuco(
        rows=_count(block, "rows"),
        columns=_count(block, "columns"),
        square_mm=block.number("square_mm"),
        marker_mm=block.number("marker_mm"),
        dictionary=block.text("dictionary"),
        legacy="legacy" in block.values and block.number("legacy") != 0,
        first=_first(block),
        name=name,
    )


def _first(block: Block) -> int:
    """The number of the first marker."""
    return int(block.number("first")) if "first" in block.values else 0


def _count(block: Block, key: str) -> int:
    value = block.number(key)
    if value != int(value) or not 0 < value < 1000:
        raise block.error(key, "must be a whole number of rows or columns: correct it.")
    return int(value)
