"""What each camera saw of the boards in each shot, and where the boards were."""

from typing import NamedTuple

import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.board_set import board_names, list_boards
from trinoc.geometry.rig import Rig
from trinoc.report.numbers import with_decimals
from trinoc.report.space_content import Box, frusta
from trinoc.report.space_part import (
    LineLayer,
    SpaceFigure,
    SpaceView,
    axes_in_space,
    cameras_in_space,
)


class ShotCell(NamedTuple):
    """One picture: what was found, and how far off; `role` is "used", "left-out", "missing" or
    "none" where the camera took no picture."""

    text: str
    words: str
    role: str


class ShotTable(NamedTuple):
    """A row for each shot, a cell for each camera."""

    cameras: tuple[str, ...]
    rows: tuple[tuple[str, tuple[ShotCell, ...]], ...]

    def count(self, role: str) -> int:
        """How many pictures are of a role."""
        return sum(cell.role == role for _, cells in self.rows for cell in cells)


def shot_table(result: CalibrationResult) -> ShotTable:
    """Every picture that was given, shots that took no part last."""
    rows: dict[tuple[str, str], list[int]] = {}
    for k, view in enumerate(result.views):
        rows.setdefault((result.cameras[view.camera], result.shots[view.shot]), []).append(k)
    cells = {place: _shot_cell(result, own) for place, own in rows.items()}
    for picture, why in result.failures.items():
        camera = max((c for c in result.cameras if picture.startswith(f"{c}, ")), key=len)
        place = camera, picture.removeprefix(f"{camera}, ")
        cells.setdefault(place, ShotCell("not found", why, "missing"))
    shots = dict.fromkeys([*result.shots, *sorted(shot for _, shot in cells)])
    none = ShotCell("\N{EN DASH}", "no picture", "none")
    table = tuple(
        (shot, tuple(cells.get((camera, shot), none) for camera in result.cameras))
        for shot in shots
    )
    return ShotTable(result.cameras, table)


def _shot_cell(result: CalibrationResult, rows: list[int]) -> ShotCell:
    """One picture, which may show several boards."""
    views = [result.views[row] for row in rows]
    used = sum(int(view.used.sum()) for view in views)
    found = sum(len(view.detection) for view in views)
    if not used:
        return ShotCell("left out", f"{found} places found, none of them used", "left-out")
    errors = np.concatenate([result.residuals_px[row][result.views[row].rows_used] for row in rows])
    rms = float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else float("nan")
    text = f"{used} of {len(result.board)}, {with_decimals(rms, 3)} px"
    return ShotCell(text, f"{used} of {found} places found are used; rms of the residuals", "used")


def boards_in_space(result: CalibrationResult, rig: Rig) -> SpaceFigure:
    """The cameras and the boards of all shots."""
    outlines = _boards(result)
    box = Box.around(np.concatenate([*frusta(rig), *outlines]), 0.05)
    names = board_names(result.board)
    which = [f"board {name}" for name in names] if len(names) > 1 else ["board"]
    words = tuple(f"{each} in shot {shot}" for shot in result.shots for each in which)
    layer = LineLayer(
        f"boards ({len(result.world_from_board)})", "sheet", outlines, True, (), words
    )
    axes = axes_in_space(0.1 * float(np.max(box.high_mm - box.low_mm)))
    figure = SpaceFigure((layer,), (), (SpaceView("Whole rig", box),))
    return figure.join(axes).join(cameras_in_space(rig))


def _boards(result: CalibrationResult) -> list[np.ndarray]:
    """The outline of the places of each board in each shot."""
    outlines = []
    for board, fixed in zip(list_boards(result.board), result.reference_from_board, strict=True):
        centres = np.asarray(board.centres_mm)
        (left, top), (right, bottom) = centres.min(axis=0), centres.max(axis=0)
        corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]
        outlines.append(np.array(corners) @ fixed[:, :2].T + fixed[:, 3])
    return [
        places @ pose[:, :3].T + pose[:, 3]
        for pose in result.world_from_board
        for places in outlines
    ]
