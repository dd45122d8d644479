"""Alternative layouts of a board, for common mistakes in describing it.

The user counted squares instead of inner corners. In a ChArUco board, rows and columns are
exchanged, markers are placed as by OpenCV before version 4.6, or white is exchanged with black.
Alternatives are tried if hardly any image shows the board as described.
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
    """An alternative layout of the board that the user may have meant.

    Attributes
    ----------
    target : board with the alternative layout.
    sentence : sentence for the user on the difference to the given layout.
    """

    target: AbstractTarget
    sentence: str


def other_readings(target: AbstractTarget) -> list[BoardReading]:
    """Alternative layouts of a chessboard with one row and one column more or fewer.

    Empty for other kinds of boards.
    """
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
    """Find an alternative layout that at least half of a sample of the images shows, or None.

    target : board with the given layout.
    shows_board : function (image, board) that returns True if the image shows the board.
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
    board_index: int,
    images: Sequence[_Image],
    load: Callable[[_Image], Any],
    tuning: CalibTuning,
) -> BoardReading | None:
    """Find the layout of a ChArUco board that the images show instead of the given one, or None.

    The first image with an alternative layout decides. The board must be the same sheet: mirror
    images and other markers are not accepted.

    Parameters
    ----------
    target : the board, or a set that contains it.
    board_index : index of the board in the set.
    images : images that do not show the given layout.
    load : function that returns the pixels of an image, or None.
    tuning : constants of the detection.
    """
    boards, names = list(list_boards(target)), board_names(target)
    board = boards[board_index]
    if not isinstance(board, Charuco) or not images:
        return None
    for k in np.unique(np.linspace(0, len(images) - 1, min(_SEARCHED, len(images))).astype(int)):
        image = load(images[k])
        reading = None if image is None else find_marker_reading(image, board, tuning)
        if reading is None or not reading.is_same_sheet:
            continue
        boards[board_index] = reading.board
        is_set = isinstance(target, BoardSet)
        changed = (
            BoardSet(dict(zip(names, boards, strict=True)), name=target.name)
            if is_set
            else reading.board
        )
        board_name = f'"{names[board_index]}"' if is_set else "the ChArUco board"
        return BoardReading(
            changed,
            f"The images show {board_name} with {' and '.join(reading.changes)}, and this layout "
            "was used. Correct the layout file.",
        )
    return None
