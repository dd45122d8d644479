"""Other readings of a board's layout that people mean: squares counted instead of inner corners;
of a ChArUco board rows and columns exchanged, markers as OpenCV placed them before version 4.6, or
white printed for black.

They are tried where hardly any image shows the board as its layout has it.
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
    """A board as its layout may have been meant, and a sentence that says so."""

    target: AbstractTarget
    sentence: str


def other_readings(target: AbstractTarget) -> list[BoardReading]:
    """Readings of the layout beside the one that it states; none for most kinds of boards."""
    readings = []
    if isinstance(target, Chessboard):
        given = f"{target.rows} x {target.columns} inner corners"
        for difference, meaning in ((-1, "its squares were counted"), (1, "one row is missing")):
            rows, columns = target.rows + difference, target.columns + difference
            if min(rows, columns) < 3:
                continue
            board = Chessboard(rows=rows, columns=columns, square_mm=target.square_mm)
            readings.append(
                BoardReading(
                    board,
                    f"The layout states {given}, but the images show {rows} x {columns} "
                    f"({meaning}): the board was read so. Mend the layout.",
                )
            )
    return readings


def find_reading(
    target: AbstractTarget,
    images: Sequence[_Image],
    found: Callable[[_Image, AbstractTarget], bool],
) -> BoardReading | None:
    """The reading that at least half of some of the images show; None where no reading does.

    found : whether an image shows a board.
    """
    if not images:
        return None
    chosen = np.unique(np.linspace(0, len(images) - 1, min(_TRIED, len(images))).astype(int))
    for reading in other_readings(target):
        hits = sum(found(images[k], reading.target) for k in chosen)
        if hits >= max(1, _SHARE * len(chosen)):
            return reading
    return None


def find_charuco_reading(
    target: AbstractTarget,
    which: int,
    images: Sequence[_Image],
    load: Callable[[_Image], Any],
    tuning: CalibTuning,
) -> BoardReading | None:
    """The reading of a ChArUco board, alone or in a set, that the first image with one shows.

    Only readings of the same sheet count: not its mirror image, nor other markers.

    which : number of the board in the set. load : pixels of an image; None where there are none.
    """
    boards, names = list(list_boards(target)), board_names(target)
    board = boards[which]
    if not isinstance(board, Charuco) or not images:
        return None
    for k in np.unique(np.linspace(0, len(images) - 1, min(_SEARCHED, len(images))).astype(int)):
        image = load(images[k])
        reading = None if image is None else find_marker_reading(image, board, tuning)
        if reading is None or not reading.is_same_sheet:
            continue
        boards[which] = reading.board
        is_set = isinstance(target, BoardSet)
        changed = (
            BoardSet(dict(zip(names, boards, strict=True)), name=target.name)
            if is_set
            else reading.board
        )
        what = f'"{names[which]}"' if is_set else "the ChArUco board"
        return BoardReading(
            changed,
            f"The images show {what} with {' and '.join(reading.changes)}: it was read so. Correct "
            "its layout.",
        )
    return None
