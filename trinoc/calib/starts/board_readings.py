"""Other readings of a board's layout, for common mistakes in stating it.

Squares are counted instead of inner corners. In a ChArUco board, rows and columns are exchanged,
markers are placed as by OpenCV before version 4.6, or white is exchanged with black. Other readings
are tried if hardly any image shows the board as stated.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np

from trinoc.calib.detection.marker_readings import find_marker_reading
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.board_set import BoardSet, board_names, list_boards
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.tuning.every_group import CalibTuning

_Image = TypeVar("_Image")
# numerical: images in which other readings are tried, and the share that must show one.
_TRIED, _SHARE = 6, 0.5
# numerical: images in which a board with markers is searched: one that shows it is enough.
_SEARCHED = 12


class BoardReading(NamedTuple):
    """A board as its layout may have been meant, and a sentence on the difference."""

    target: AbstractTarget
    sentence: str


def other_readings(target: AbstractTarget) -> list[BoardReading]:
    """Other readings of a layout; empty for most kinds of boards."""
    readings = []
    if isinstance(target, Chessboard):
        stated = f"{target.rows} x {target.columns} inner corners"
        for difference, meaning in (
            (-1, "the layout states the number of squares"),
            (1, "one row is missing"),
        ):
            rows, columns = target.rows + difference, target.columns + difference
            if min(rows, columns) < 3:
                continue
            board = Chessboard(rows=rows, columns=columns, square_mm=target.square_mm)
            readings.append(
                BoardReading(
                    board,
                    f"The layout states {stated}, but the images show {rows} x {columns} "
                    f"({meaning}), and this size was used. Correct the layout file.",
                )
            )
    return readings


def find_reading(
    target: AbstractTarget,
    images: Sequence[_Image],
    shows_board: Callable[[_Image, AbstractTarget], bool],
) -> BoardReading | None:
    """Reading that at least half of a sample of the images shows; None without one.

    shows_board : function (image, board) that decides whether an image shows a board.
    """
    if not images:
        return None
    sample = np.unique(np.linspace(0, len(images) - 1, min(_TRIED, len(images))).astype(int))
    for reading in other_readings(target):
        hits = sum(shows_board(images[k], reading.target) for k in sample)
        if hits >= max(1, _SHARE * len(sample)):
            return reading
    return None


def find_charuco_reading(
    target: AbstractTarget,
    number: int,
    images: Sequence[_Image],
    load: Callable[[_Image], Any],
    tuning: CalibTuning,
) -> BoardReading | None:
    """Reading of a ChArUco board, alone or in a set, from the first image that shows one.

    Only readings of the same sheet are accepted: not its mirror image, nor other markers.

    number : of the board in the set. load : function that returns the pixels of an image, or
        None.
    """
    boards, names = list(list_boards(target)), board_names(target)
    board = boards[number]
    if not isinstance(board, Charuco) or not images:
        return None
    for k in np.unique(np.linspace(0, len(images) - 1, min(_SEARCHED, len(images))).astype(int)):
        image = load(images[k])
        reading = None if image is None else find_marker_reading(image, board, tuning)
        if reading is None or not reading.is_same_sheet:
            continue
        boards[number] = reading.board
        is_set = isinstance(target, BoardSet)
        changed = (
            BoardSet(dict(zip(names, boards, strict=True)), name=target.name)
            if is_set
            else reading.board
        )
        board_name = f'"{names[number]}"' if is_set else "the ChArUco board"
        return BoardReading(
            changed,
            f"The images show {board_name} with {' and '.join(reading.changes)}, and this layout "
            "was used. Correct the layout file.",
        )
    return None
