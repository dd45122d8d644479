"""Lenses, cameras and board beside their sigmas."""

import numpy as np

from trinoc.calib import RigFromShots, board_names
from trinoc.geometry import SPLINE_PARAMETERS
from trinoc.report.numbers import with_decimals, with_sigma

# (name, cell of each camera); a cell of no text is a parameter that the camera has not.
_IN_SET = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")
Rows = tuple[tuple[str, tuple[str, ...]], ...]


def parameter_columns(result: RigFromShots) -> tuple[Rows, Rows]:
    """Rows of the cameras, a cell for each; and those of the board, with one cell."""
    prefixes = [f"{camera}." for camera in result.cameras]
    names = dict.fromkeys(
        name.removeprefix(prefix)
        for prefix in prefixes
        for name in result.parameters
        if name.startswith(prefix) and name.removeprefix(prefix) not in SPLINE_PARAMETERS
    )
    cameras = tuple(
        (name, tuple(_words(result, prefix + name) for prefix in prefixes)) for name in names
    )
    # How boards are fixed to each other stands in sentences of its own.
    apart = [f"board.{name}.{axis}" for name in board_names(result.target) for axis in _IN_SET]
    board = tuple(
        (name.removeprefix("board."), (_words(result, name),))
        for name in result.parameters
        if name.startswith("board.") and name not in apart
    )
    return cameras, board


def _words(result: RigFromShots, name: str) -> str:
    if name not in result.parameters:
        return ""
    value, sigma = result.value(name), result.sigma(name)
    if not np.isfinite(value):
        return "not determined"
    return f"{with_decimals(value, 4)}, held" if sigma == 0 else with_sigma(value, sigma)
