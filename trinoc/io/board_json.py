"""Boards of squares as JSON, beside the layouts of sheets of circles."""

import os
from typing import Any

from trinoc.calib import AbstractTarget, AprilGrid, Charuco, Chessboard, Pattern
from trinoc.errors import InputError
from trinoc.io import pattern_json
from trinoc.io.json_document import Block, read_document, write_document
from trinoc.io.json_text import parsed_json
from trinoc.io.whole_files import read_text

FORMAT, VERSION = "trinoc-board", 1

_CONVENTIONS = (
    "mm on the board Z = 0; seen from the printed side X points right and Y up, the origin is in"
    " the middle of the inner corners, which are ordered row by row from the top left; the top"
    " left square is dark (of a legacy ChArUco with an even number of rows it holds a marker); tags"
    " of an AprilGrid are numbered along the rows from the lower left; spacing is gap over tag."
)


def load_target(path: str | os.PathLike[str]) -> AbstractTarget:
    """Read a layout of a sheet of circles, a chessboard, a ChArUco board or an AprilGrid.

    Raises InputError.
    """
    values = parsed_json(read_text(path), path)
    if isinstance(values, dict) and values.get("format") == FORMAT:
        return _board(read_document(path, FORMAT, VERSION))
    return pattern_json.load_pattern(path)


def save_target(target: AbstractTarget, path: str | os.PathLike[str]) -> None:
    """Write a board; `load_target` gives the same one back."""
    if isinstance(target, Pattern):
        pattern_json.save_pattern(target, path)
        return
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION, "name": target.name}
    match target:
        case Chessboard():
            document["chessboard"] = {
                "inner_rows": target.rows,
                "inner_columns": target.columns,
                "square_mm": target.square_mm,
            }
        case Charuco():
            document["charuco"] = {
                "rows": target.rows,
                "columns": target.columns,
                "square_mm": target.square_mm,
                "marker_mm": target.marker_mm,
                "dictionary": target.dictionary,
                "legacy": int(target.legacy),
            }
        case AprilGrid():
            document["aprilgrid"] = {
                "rows": target.rows,
                "columns": target.columns,
                "tag_mm": target.tag_mm,
                "spacing": target.spacing,
                "dictionary": target.dictionary,
                "border": target.border,
                "first": target.first,
            }
        case _:
            raise InputError(f"A {type(target).__name__} has no file: give a board or a Pattern.")
    write_document(path, {**document, "conventions": _CONVENTIONS})


def _board(document: Block) -> AbstractTarget:
    kinds = ("chessboard", "charuco", "aprilgrid")
    document.expect_keys(("format", "version", "name"), (*kinds, "conventions"))
    given = [kind for kind in kinds if kind in document.values]
    if len(given) != 1:
        raise document.error(
            "chessboard", "charuco or aprilgrid must be there, one of them: add it."
        )
    block, name = document.block(given[0]), document.text("name")
    try:
        if given[0] == "chessboard":
            block.expect_keys(("inner_rows", "inner_columns", "square_mm"))
            return Chessboard(
                rows=_count(block, "inner_rows"),
                columns=_count(block, "inner_columns"),
                square_mm=block.number("square_mm"),
                name=name,
            )
        if given[0] == "aprilgrid":
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
                first=int(block.number("first")) if "first" in block.values else 0,
                name=name,
            )
        block.expect_keys(("rows", "columns", "square_mm", "marker_mm", "dictionary"), ("legacy",))
        return Charuco(
            rows=_count(block, "rows"),
            columns=_count(block, "columns"),
            square_mm=block.number("square_mm"),
            marker_mm=block.number("marker_mm"),
            dictionary=block.text("dictionary"),
            legacy="legacy" in block.values and block.number("legacy") != 0,
            name=name,
        )
    except InputError as error:
        if str(error).startswith(document.file):
            raise
        raise InputError(f"{document.file}: {error}") from error


def _count(block: Block, key: str) -> int:
    value = block.number(key)
    if value != int(value) or not 0 < value < 1000:
        raise block.error(key, "must be a whole number of rows or columns: correct it.")
    return int(value)
