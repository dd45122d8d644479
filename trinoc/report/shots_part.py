"""Table of the shots of a calibration, and the boards of all shots in space."""

import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.board_set import board_names, list_boards
from trinoc.geometry.rig import Rig
from trinoc.report.numbers import with_decimals
from trinoc.report.report_table import Cell, ReportTable
from trinoc.report.space_content import Box, frusta
from trinoc.report.space_part import (
    LineLayer,
    SpaceFigure,
    SpaceView,
    axes_in_space,
    cameras_in_space,
)


def shot_table(result: CalibrationResult) -> ReportTable:
    """Table with a row for each shot and a column for each camera. Shots that were not used come
    last.

    The CSS class of a cell is "used", "left-out", "missing" (no board detected), or "none" (no
    image).
    """
    rows: dict[tuple[str, str], list[int]] = {}
    for k, view in enumerate(result.views):
        rows.setdefault((result.cameras[view.camera], result.shots[view.shot]), []).append(k)
    cells = {key: _shot_cell(result, numbers) for key, numbers in rows.items()}
    for picture, why in result.failures.items():
        camera = max((c for c in result.cameras if picture.startswith(f"{c}, ")), key=len)
        key = camera, picture.removeprefix(f"{camera}, ")
        cells.setdefault(key, _cell("not found", "missing", why))
    shots = dict.fromkeys([*result.shots, *sorted(shot for _, shot in cells)])
    none = _cell("\N{EN DASH}", "none", "no picture")
    table = [
        [shot, *(cells.get((camera, shot), none) for camera in result.cameras)] for shot in shots
    ]
    return ReportTable(("shot", *result.cameras), table, look="shots")


def count_shots(table: ReportTable, role: str) -> int:
    """Number of images in a table of shots whose cells have the class `role`."""
    return sum(cell.attributes.get("class") == role for row in table.cells() for cell in row)


def _cell(text: str, role: str, hint: str) -> Cell:
    return Cell(text, attributes={"class": role, "title": hint})


def _shot_cell(result: CalibrationResult, rows: list[int]) -> Cell:
    """Cell of one image. rows : indices of the observations of boards in this image."""
    views = [result.views[row] for row in rows]
    used = sum(int(view.used.sum()) for view in views)
    detected = sum(len(view.detection) for view in views)
    if not used:
        return _cell("left out", "left-out", f"{detected} places found, none of them used")
    errors = np.concatenate([result.residuals_px[row][result.views[row].rows_used] for row in rows])
    rms = float(np.sqrt(np.mean(np.sum(errors**2, axis=1)))) if len(errors) else float("nan")
    text = f"{used} of {len(result.board)}, {with_decimals(rms, 3)} px"
    hint = f"{used} of {detected} places found are used; rms of the residuals"
    return _cell(text, "used", hint)


def boards_in_space(result: CalibrationResult, rig: Rig) -> SpaceFigure:
    """3-D figure of the cameras and of the boards in all shots."""
    outlines = _boards(result)
    box = Box.around(np.concatenate([*frusta(rig), *outlines]), 0.05)
    names = board_names(result.board)
    labels = [f"board {name}" for name in names] if len(names) > 1 else ["board"]
    descriptions = tuple(f"{label} in shot {shot}" for shot in result.shots for label in labels)
    layer = LineLayer(
        f"boards ({len(result.world_from_board)})", "sheet", outlines, True, (), descriptions
    )
    axes = axes_in_space(0.1 * float(np.max(box.high_mm - box.low_mm)))
    figure = SpaceFigure((layer,), (), (SpaceView("Whole rig", box),))
    return figure.join(axes).join(cameras_in_space(rig))


def _boards(result: CalibrationResult) -> list[np.ndarray]:
    """Outline of each board in each shot, as (5, 3) lines in the world, mm."""
    outlines = []
    for board, pose in zip(list_boards(result.board), result.reference_from_board, strict=True):
        centres = np.asarray(board.centres_mm)
        (left, top), (right, bottom) = centres.min(axis=0), centres.max(axis=0)
        corners = [[left, top], [right, top], [right, bottom], [left, bottom], [left, top]]
        outlines.append(np.array(corners) @ pose[:, :2].T + pose[:, 3])
    return [
        outline @ pose[:, :3].T + pose[:, 3]
        for pose in result.world_from_board
        for outline in outlines
    ]
