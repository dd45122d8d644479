"""Recovered parameters beside known ones."""

from typing import NamedTuple

from trinoc.geometry import PARAMETER_NAMES, Rig


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


def parameter_value(rig: Rig, name: str, parameter: str) -> float:
    """A parameter of `PARAMETER_NAMES` of one camera of a rig."""
    camera = rig[name]
    if parameter.startswith("aim_"):
        return camera.aim_mm[0 if parameter == "aim_x_mm" else 1]
    return getattr(camera, parameter)


def parameter_error(rig: Rig, reference: Rig, name: str, parameter: str) -> ParameterError:
    """One parameter of one camera that both rigs have."""
    value, known = (parameter_value(cameras, name, parameter) for cameras in (rig, reference))
    sigma, error = rig.sigma(f"{name}.{parameter}"), value - known
    over_sigma = error / sigma if sigma > 0 else float("nan")
    return ParameterError(name, parameter, value, sigma, known, error, over_sigma)


def parameter_errors(rig: Rig, reference: Rig) -> tuple[ParameterError, ...]:
    """Pan, tilt, swing and distance of every camera that both rigs have."""
    return tuple(
        parameter_error(rig, reference, name, parameter)
        for name in rig
        if name in reference.names
        for parameter in PARAMETER_NAMES[:4]
    )
