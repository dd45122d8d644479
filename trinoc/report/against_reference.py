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


def parameter_error(rig: Rig, reference: Rig, name: str, parameter: str) -> ParameterError:
    """One parameter of one camera that both rigs have."""
    key = f"{name}.{parameter}"
    value, known, sigma = rig.value(key), reference.value(key), rig.sigma(key)
    error = value - known
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
