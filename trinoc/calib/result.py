"""The answer of a calibration, which never travels without its status and its sigmas."""

import enum

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.pattern import Pattern
from trinoc.geometry.rig import Rig


class Status(enum.Enum):
    """How the fit of one camera ended; the value is the sentence shown to people."""

    CONVERGED = "The fit converged and its parameters are determined."
    NOT_CONVERGED = "The fit did not converge: its parameters are not a result."
    RANK_DEFICIENT = "The observations leave some parameters free: see the named gauge."


class CameraFit(eqx.Module):
    """What the fit of one camera's picture says about itself.

    Fields
    ------
    detection : the circles and lines it was fitted to.
    residuals_px : (m, 2) predicted minus observed centre of each circle of the detection.
    rank : of the column-scaled Jacobian.
    reduced_chi_square : chi-square over degrees of freedom.
    gauge : names of the parameters that the observations leave free.
    notes : sentences on what a user should know (covered circles, dropped outliers, ...).
    """

    detection: Detection
    residuals_px: Float[np.ndarray, "m 2"]
    rank: int = eqx.field(static=True)
    reduced_chi_square: float = eqx.field(static=True)
    gauge: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)


class CalibrationResult(eqx.Module):
    """A calibrated rig with parameters, covariance, and the fit of each camera.

    Fields
    ------
    rig : the cameras; its covariance is the one below.
    status : per camera.
    parameters : names such as "upper.pan_deg", the rows of `covariance`.
    values : (p,) of `parameters`, degrees and mm.
    covariance : (p, p), degrees and mm.
    fits : per camera.
    pattern : the sheet.
    """

    rig: Rig
    status: dict[str, Status]
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    fits: dict[str, CameraFit]
    pattern: Pattern
