"""Parameters beside their sigmas and, where there are any, known values."""

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
# Of cameras in a world without a sheet, whose axes need not meet Z = 0.
PLACE_NAMES = tuple(name for name in LABELS if name.startswith(("position_", "direction_")))
# How a board is fixed to the first: it stands in sentences of its own.
_FIXED = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


class ParameterError(NamedTuple):
    """One recovered parameter, its sigma, the known value, and how far off it is.

    Degrees or millimetres, as `parameter` says; `over_sigma` is NaN where sigma is not known.
    """

    camera: str
    parameter: str
    value: float
    sigma: float
    known: float
    error: float
    over_sigma: float


class ParameterCell(NamedTuple):
    """One parameter of one camera: value and sigma, and the comparison with a known value."""

    name: str
    text: str
    reference: str = ""
    error: str = ""
    error_over_sigma: str = ""
    beyond: bool = False


Rows = tuple[tuple[str, tuple[ParameterCell, ...]], ...]


def parameter_errors(rig: Rig, reference: Rig) -> tuple[ParameterError, ...]:
    """Pan, tilt, swing and distance of every camera that both rigs have."""
    return tuple(
        _parameter_error(rig, reference, name, parameter)
        for name in rig
        if name in reference.names
        for parameter in PARAMETER_NAMES[:4]
    )


def _parameter_error(rig: Rig, reference: Rig, name: str, parameter: str) -> ParameterError:
    key = f"{name}.{parameter}"
    value, known, sigma = rig.value(key), reference.value(key), rig.sigma(key)
    error = value - known
    over_sigma = error / sigma if sigma > 0 else float("nan")
    return ParameterError(name, parameter, value, sigma, known, error, over_sigma)


def is_without_sheet(rig: Rig) -> bool:
    """Whether some optical axis does not meet Z = 0, and no calibration over a sheet says so."""
    known = {parameter.rpartition(".")[2] for parameter in rig.parameters}
    distances = [camera.distance_mm for camera in rig.cameras]
    return "distance_mm" not in known and not np.isfinite(distances).all()


def shown_parameters(rig: Rig) -> tuple[str, ...]:
    """The four parameters of the method, and the aim where it is not the world's origin; in a
    world without a sheet positions and viewing directions."""
    if is_without_sheet(rig):
        return PLACE_NAMES
    aims = np.array([camera.aim_mm for _, camera in rig.items()])
    free = any(parameter.split(".")[-1].startswith("aim_") for parameter in rig.parameters)
    shown = free or np.any(np.abs(np.nan_to_num(aims)) > 1e-6)
    return PARAMETER_NAMES if shown else PARAMETER_NAMES[:4]


def shown_value(rig: Rig, name: str, parameter: str) -> tuple[float, float]:
    """Value and sigma of a parameter that `shown_parameters` lists."""
    if parameter not in PLACE_NAMES:
        return rig.value(f"{name}.{parameter}"), rig.sigma(f"{name}.{parameter}")
    kind, axis = parameter.split("_")[:2]
    camera = rig[name]
    vector = camera.centre_world_mm if kind == "position" else camera.pose.rotation[2]
    return float(vector["xyz".index(axis)]), float("nan")


def parameter_rows(rig: Rig, reference: Rig | None) -> Rows:
    """A labelled row for each parameter, a cell for each camera."""
    return tuple(
        (LABELS[parameter], tuple(_cell(rig, name, parameter, reference) for name in rig))
        for parameter in shown_parameters(rig)
    )


def _cell(rig: Rig, name: str, parameter: str, reference: Rig | None) -> ParameterCell:
    words, (value, sigma) = f"{name}.{parameter}", shown_value(rig, name, parameter)
    if parameter in PLACE_NAMES:
        return ParameterCell(words, with_decimals(value, 2 if parameter.endswith("_mm") else 4))
    text = with_sigma(value, sigma)
    if reference is None or name not in reference.names:
        return ParameterCell(words, text)
    found = _parameter_error(rig, reference, name, parameter)
    return ParameterCell(
        words,
        text,
        with_decimals(found.known, 3),
        with_sign(found.error, significant_decimals(sigma)),
        with_sign(found.over_sigma, 1),
        abs(found.over_sigma) > 3,
    )


def parameter_rows_of_shots(result: CalibrationResult) -> Rows:
    """Lens and pose of every camera; a cell of no text is a parameter that the camera has not."""
    names = dict.fromkeys(
        key
        for camera in result.cameras
        for owner, _, key in (name.rpartition(".") for name in result.parameters)
        if owner == camera
    )
    return tuple(
        (
            LABELS.get(name, name),
            tuple(_cell_of_shots(result, f"{camera}.{name}") for camera in result.cameras),
        )
        for name in names
        if name not in SPLINE_PARAMETERS
    )


PAIR_HEAD = (
    "cameras",
    "baseline (mm)",
    "board's size",
    "the rest",
    "rotation (deg)",
    *(f"{axis} (deg)" for axis in "xyz"),
)


def pair_rows(result: CalibrationResult) -> tuple[tuple[str, ...], ...]:
    """Baseline and relative rotation of each pair of cameras, the cells of `PAIR_HEAD`."""
    return tuple(
        (
            f"{pair.first}, {pair.second}",
            with_sigma(pair.baseline_mm, pair.baseline_sigma_mm),
            f"± {millimetres(pair.size_sigma_mm)}",
            f"± {millimetres(pair.rest_sigma_mm)}",
            with_sigma(pair.angle_deg, pair.angle_sigma_deg),
            *(
                with_sigma(float(value), float(sigma))
                for value, sigma in zip(pair.turn_deg, pair.turn_sigma_deg, strict=True)
            ),
        )
        for pair in result.pairs
    )


def parameter_rows_of_boards(result: CalibrationResult) -> Rows:
    """What was fitted of the boards, but not how they are fixed to each other."""
    fixed = [f"board.{name}.{axis}" for name in board_names(result.board) for axis in _FIXED]
    return tuple(
        (name.removeprefix("board."), (_cell_of_shots(result, name),))
        for name in result.parameters
        if name.startswith("board.") and name not in fixed
    )


def _cell_of_shots(result: CalibrationResult, name: str) -> ParameterCell:
    if name not in result.parameters:
        return ParameterCell(name, "")
    value, sigma = result.value(name), result.sigma(name)
    if not np.isfinite(value):
        return ParameterCell(name, "not determined")
    held = f"{with_decimals(value, 4)}, held"
    return ParameterCell(name, held if sigma == 0 else with_sigma(value, sigma))
