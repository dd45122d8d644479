"""A chessboard as a sheet: what the fit of grey levels takes."""

import dataclasses

import numpy as np

from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.pattern import CORNERS, Pattern

# Of a square's side: how far about a corner its edges count as its own.
REACH = 0.49
_HOLE = 0.25


def corner_sheet(board: Chessboard) -> Pattern:
    """The inner corners of a board as the places of a sheet in the line style `CORNERS`.

    About a place the radius is how far its edges are looked at. An inner radius above 0 says
    that the dark squares lie upper right and lower left of the corner, 0 that they lie upper left
    and lower right.
    """
    grid = Pattern.circle_grid(
        rows=board.rows,
        columns=board.columns,
        pitch_mm=board.square_mm,
        radius_mm=REACH * board.square_mm,
        name=board.name,
    )
    row, column = np.divmod(np.arange(board.rows * board.columns), board.columns)
    hole = np.where((row + column) % 2 == 1, _HOLE * board.square_mm, 0.0)
    return dataclasses.replace(grid, inner_radius_mm=hole, line_style=CORNERS)
