"""Other readings of a board's layout that people mean: squares counted instead of inner corners,
rows and columns exchanged, markers as OpenCV placed them before version 4.6.

They are tried where hardly any image shows the board as its layout has it.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

import numpy as np

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.checkers import Charuco, Chessboard

_Image = TypeVar("_Image")
# numerical: images in which other readings are tried, and the share that must show one.
_TRIED, _SHARE = 6, 0.5


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
    if isinstance(target, Charuco):
        for exchanged in (False, True):
            for legacy in (False, True):
                if (exchanged, legacy) == (False, target.legacy):
                    continue
                sides = (target.rows, target.columns)
                rows, columns = sides[::-1] if exchanged else sides
                board = Charuco(
                    rows=rows,
                    columns=columns,
                    square_mm=target.square_mm,
                    marker_mm=target.marker_mm,
                    dictionary=target.dictionary,
                    legacy=legacy,
                    first=target.first,
                )
                changes = [
                    *(["rows and columns exchanged"] if exchanged else []),
                    *([f"legacy={'yes' if legacy else 'no'}"] if legacy != target.legacy else []),
                ]
                readings.append(
                    BoardReading(
                        board,
                        f"The images show the ChArUco board with {' and '.join(changes)}: it was "
                        "read so. Mend the layout.",
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
