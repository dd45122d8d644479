"""Parameters beside their sigmas and, where there are any, known values."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.board_set import board_names
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.report.numbers import (
    millimetres,
    significant_decimals,
    with_decimals,
    with_sigma,
    with_sign,
)
from trinoc.report.report_table import Cell, ReportTable

LABELS = {
    "pan_deg": "pan (deg)",
    "tilt_deg": "tilt (deg)",
    "swing_deg": "swing (deg)",
    "distance_mm": "distance (mm)",
    "aim_x_mm": "aim X (mm)",
    "aim_y_mm": "aim Y (mm)",
    "position_x_mm": "position X (mm)",
    "position_y_mm": "position Y (mm)",
    "position_z_mm": "position Z (mm)",
    "direction_x": "viewing direction X",
    "direction_y": "viewing direction Y",
    "direction_z": "viewing direction Z",
}
# In a world without a sheet, where the axes of cameras need not meet Z = 0.
PLACEMENT_NAMES = tuple(name for name in LABELS if name.startswith(("position_", "direction_")))
# The pose of a board in a set: sentences of their own report it.
_BOARD_POSE = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


class ParameterError(NamedTuple):
    """Error of one estimated parameter of a camera.

    Attributes
    ----------
    camera, parameter : str
        Names.
    value, sigma : float
        Estimate and its standard deviation, in degrees or millimetres as `parameter` states.
    known : float
        Value in the reference.
    error : float
        Estimate minus reference.
    over_sigma : float
        Error over sigma; NaN without a sigma.
    """

    camera: str
    parameter: str
    value: float
    sigma: float
    known: float
    error: float
    over_sigma: float


def parameter_errors(rig: Rig, reference: Rig) -> tuple[ParameterError, ...]:
    """Errors of pan, tilt, swing and distance of every camera that both rigs have."""
    return tuple(
        _parameter_error(rig, reference, name, parameter)
        for name in rig
        if name in reference.names
        for parameter in PARAMETER_NAMES[:4]
    )


def _parameter_error(rig: Rig, reference: Rig, name: str, parameter: str) -> ParameterError:
    key = f"{name}.{parameter}"
    value, true_value, sigma = rig.value(key), reference.value(key), rig.sigma(key)
    error = value - true_value
    over_sigma = error / sigma if sigma > 0 else float("nan")
    return ParameterError(name, parameter, value, sigma, true_value, error, over_sigma)


def is_without_sheet(rig: Rig) -> bool:
    """True if an optical axis does not meet Z = 0 and the rig was not calibrated with a sheet."""
    names = {parameter.rpartition(".")[2] for parameter in rig.parameters}
    distances = [camera.distance_mm for camera in rig.cameras]
    return "distance_mm" not in names and not np.isfinite(distances).all()


def shown_parameters(rig: Rig) -> tuple[str, ...]:
    """Names of the parameters that a table of the rig lists.

    They are pan, tilt, swing and distance, and the aim if it is not at the origin. If the rig was
    not calibrated with a sheet, they are the cameras' positions and viewing directions.
    """
    if is_without_sheet(rig):
        return PLACEMENT_NAMES
    aims = np.array([camera.aim_mm for _, camera in rig.items()])
    is_free = any(parameter.split(".")[-1].startswith("aim_") for parameter in rig.parameters)
    has_aim = is_free or np.any(np.abs(np.nan_to_num(aims)) > 1e-6)
    return PARAMETER_NAMES if has_aim else PARAMETER_NAMES[:4]


def shown_value(rig: Rig, name: str, parameter: str) -> tuple[float, float]:
    """Value and sigma of a parameter of camera `name`. parameter : one of `shown_parameters`."""
    if parameter not in PLACEMENT_NAMES:
        return rig.value(f"{name}.{parameter}"), rig.sigma(f"{name}.{parameter}")
    kind, axis = parameter.split("_")[:2]
    camera = rig[name]
    vector = camera.centre_world_mm if kind == "position" else camera.pose.rotation[2]
    return float(vector["xyz".index(axis)]), float("nan")


def rig_table(rig: Rig, reference: Rig | None = None) -> ReportTable:
    """Table of a rig's parameters, with a row for each parameter and a column for each camera.

    With `reference`, a second line of each cell shows the reference value and the error.
    """
    rows = [
        [LABELS[parameter], *(_rig_cell(rig, name, parameter, reference) for name in rig)]
        for parameter in shown_parameters(rig)
    ]
    return _table_of_cameras(rig.names, rows)


def _table_of_cameras(cameras: Sequence[str], rows: Sequence[Sequence[Cell | str]]) -> ReportTable:
    return ReportTable(("parameter", *cameras), rows, look="parameters")


def _rig_cell(rig: Rig, name: str, parameter: str, reference: Rig | None) -> Cell:
    value, sigma = shown_value(rig, name, parameter)
    if parameter in PLACEMENT_NAMES:
        text = with_decimals(value, 2 if parameter.endswith("_mm") else 4)
        return _cell(name, parameter, text)
    text = with_sigma(value, sigma)
    if reference is None or name not in reference.names:
        return _cell(name, parameter, text)
    comparison = _parameter_error(rig, reference, name, parameter)
    is_beyond = abs(comparison.over_sigma) > 3
    error = with_sign(comparison.error, significant_decimals(sigma))
    over_sigma = f"{with_sign(comparison.over_sigma, 1)} \N{GREEK SMALL LETTER SIGMA}"
    detail = f"{with_decimals(comparison.known, 3)}, error {error} ({over_sigma})"
    detail += " *" if is_beyond else ""
    cell = _cell(name, parameter, text, detail)
    return cell._replace(attributes={**cell.attributes, "class": "beyond"}) if is_beyond else cell


def _cell(camera: str, parameter: str, text: str, detail: str = "") -> Cell:
    # On a narrow screen each value stands beside the name of its camera.
    return Cell(text, detail, {"data-parameter": f"{camera}.{parameter}", "data-label": camera})


def lens_table(result: CalibrationResult) -> ReportTable:
    """Table of lens and pose of every camera of a rig from many shots.

    It is empty if a camera was not determined.
    """
    names = dict.fromkeys(
        key
        for camera in result.cameras
        for owner, _, key in (name.rpartition(".") for name in result.parameters)
        if owner == camera
    )
    rows = [
        [
            LABELS.get(name, name),
            *(
                _cell(camera, name, _estimate_text(result, f"{camera}.{name}"))
                for camera in result.cameras
            ),
        ]
        for name in names
        if name not in SPLINE_PARAMETERS
    ]
    return _table_of_cameras(result.cameras, rows)


def pairs_table(result: CalibrationResult) -> ReportTable:
    """Table of baseline and relative rotation of each pair of cameras."""
    head = ("cameras", "baseline (mm)", "board's size", "the rest", "rotation (deg)")
    rows = [
        [
            f"{pair.first}, {pair.second}",
            with_sigma(pair.baseline_mm, pair.baseline_sigma_mm),
            f"± {millimetres(pair.size_sigma_mm)}",
            f"± {millimetres(pair.rest_sigma_mm)}",
            with_sigma(pair.angle_deg, pair.angle_sigma_deg),
            *(
                with_sigma(float(value), float(sigma))
                for value, sigma in zip(pair.turn_deg, pair.turn_sigma_deg, strict=True)
            ),
        ]
        for pair in result.pairs
    ]
    note = (
        "Baseline: the distance between the centres of projection. Its sigma has two parts: the "
        "error of the board's size, a scale that no image shows, and the rest. Rotation: the angle "
        "that turns the axes of the first camera into those of the second, then the same as a "
        "rotation vector about the x, y and z axes of the first."
    )
    return ReportTable((*head, *(f"{axis} (deg)" for axis in "xyz")), rows, note=note)


def boards_table(result: CalibrationResult) -> ReportTable:
    """Table of the boards' estimated parameters, such as the scale of the print.

    The relative poses of boards that are fixed to each other are omitted.
    """
    poses = [f"board.{name}.{axis}" for name in board_names(result.board) for axis in _BOARD_POSE]
    rows = [
        [name.removeprefix("board."), _estimate_text(result, name)]
        for name in result.parameters
        if name.startswith("board.") and name not in poses
    ]
    return ReportTable((), rows)


def _estimate_text(result: CalibrationResult, name: str) -> str:
    """Value and sigma of a parameter as text; "" if the result has no parameter of this name."""
    if name not in result.parameters:
        return ""
    value, sigma = result.value(name), result.sigma(name)
    if not np.isfinite(value):
        return "not determined"
    return f"{with_decimals(value, 4)}, held" if sigma == 0 else with_sigma(value, sigma)
