"""The parameters of a rig beside their sigmas and, where there are any, known values."""

from typing import NamedTuple

import numpy as np

from trinoc.geometry import PARAMETER_NAMES, Rig
from trinoc.report.against_reference import parameter_error
from trinoc.report.numbers import decimals_for, signed, with_decimals, with_sigma

LABELS = {
    "pan_deg": "pan (deg)",
    "tilt_deg": "tilt (deg)",
    "swing_deg": "swing (deg)",
    "distance_mm": "distance (mm)",
    "aim_x_mm": "aim X (mm)",
    "aim_y_mm": "aim Y (mm)",
}


class ParameterCell(NamedTuple):
    """One parameter of one camera: value and sigma, and the comparison with a known value."""

    name: str
    text: str
    reference: str
    error: str
    error_over_sigma: str
    beyond: bool


def shown_parameters(rig: Rig) -> tuple[str, ...]:
    """The four parameters of the method, and the aim where it is not the world's origin."""
    aims = np.array([camera.aim_mm for _, camera in rig.items()])
    free = any(parameter.split(".")[-1].startswith("aim_") for parameter in rig.parameters)
    shown = free or np.any(np.abs(np.nan_to_num(aims)) > 1e-6)
    return PARAMETER_NAMES if shown else PARAMETER_NAMES[:4]


def parameter_rows(
    rig: Rig, reference: Rig | None
) -> tuple[tuple[str, tuple[ParameterCell, ...]], ...]:
    """A labelled row for each parameter, a cell for each camera."""
    return tuple(
        (LABELS[parameter], tuple(_cell(rig, name, parameter, reference) for name in rig))
        for parameter in shown_parameters(rig)
    )


def _cell(rig: Rig, name: str, parameter: str, reference: Rig | None) -> ParameterCell:
    words, sigma = f"{name}.{parameter}", rig.sigma(f"{name}.{parameter}")
    text = with_sigma(rig.value(f"{name}.{parameter}"), sigma)
    if reference is None or name not in reference.names:
        return ParameterCell(words, text, "", "", "", False)
    found = parameter_error(rig, reference, name, parameter)
    return ParameterCell(
        words,
        text,
        with_decimals(found.known, 3),
        signed(found.error, decimals_for(sigma)),
        signed(found.over_sigma, 1),
        abs(found.over_sigma) > 3,
    )
