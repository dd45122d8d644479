"""Boards as JSON, by the fields that each kind names; sheets of circles have their own layout."""

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

from trinoc.calib.targets.abstract_target import AbstractBoard, AbstractTarget
from trinoc.calib.targets.board_set import BOARDS, BoardSet
from trinoc.calib.targets.pattern import Pattern
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
            name: {"name": board.name, **_values_of_board(board)} for name, board in members
        }
    elif isinstance(target, AbstractBoard):
        document |= _values_of_board(target)
    else:
        raise InputError(f"A {type(target).__name__} has no file: give a board or a Pattern.")
    write_document(path, {**document, "conventions": _CONVENTIONS})


def _values_of_board(board: AbstractBoard) -> dict[str, Any]:
    if isinstance(board, Pattern):
        return {board.kind: pattern_json.list_figures(board)}
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
    given = [kind for kind in kinds if kind in document.values]
    if len(given) != 1:
        *others, last = kinds[1:]
        listed = " or ".join([", ".join(others), last] if others else [last])
        raise document.error(kinds[0], f"{listed} must be there, one of them: add it.")
    board, block, name = BOARDS[given[0]], document.block(given[0]), document.text("name")
    try:
        if board is Pattern:
            block.expect_keys(("circles",), ("lines",))
            return pattern_json.parse_pattern(block, name)
        required = [key for key in board.layout if key not in board.added_keys]
        block.expect_keys(required, board.added_keys)
        return board(**_fields(block, board), name=name)
    except InputError as error:
        if str(error).startswith(document.file):
            raise
        raise InputError(f"{document.file}: {error}") from error


def _fields(block: Block, board: type[AbstractBoard]) -> dict[str, Any]:
    """The fields of a board that the file holds, of the types that the class states."""
    types: dict[str, Any] = {field.name: field.type for field in dataclasses.fields(board)}
    values = {}
    for key, field in board.layout.items():
        if key in block.values:
            value = block.text(key) if types[field] is str else block.number(key)
            if types[field] is int and value != int(value):
                raise block.error(key, "must be a whole number: correct it.")
            values[field] = types[field](value)
    return values
