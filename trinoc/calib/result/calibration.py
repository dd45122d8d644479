"""The answer of a calibration, which never travels without its status and its sigmas."""

import enum
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.display import Displayable
from trinoc.numerics.values import Value


class Status(enum.Enum):
    """How the fit of one camera ended; the value is the sentence shown to people."""

    CONVERGED = "The fit converged and its parameters are determined."
    SUSPECT = "The fit converged, but its residuals are not those of this model: see the notes."
    NOT_CONVERGED = "The fit did not converge: its parameters are not a result."
    NOT_DETECTED = "The sheet was not found in the picture."
    AMBIGUOUS = "The sheet looks the same turned, and nothing says which way round it lies."
    RANK_DEFICIENT = "The observations leave some parameters free: see the named gauge."


class Alternative(NamedTuple):
    """One thing that the model holds fixed, and what the residuals say of it.

    Fields
    ------
    name : "aim", "focal length", "aspect", "principal point" or "radial distortion".
    chi_square_drop : likelihood ratio against the model as it is.
    p_value : probability of such a drop by noise alone.
    estimate : of the change, in mm of aim, share of the focal length, that along v against that
        along u, px, or k1.
    sigma : of the estimate.
    sentence : what it means.
    strain : by how many of its sigmas the change would move the camera (Mahalanobis distance).
    unseen : of changes that the residuals may well not show, the one that moves the camera most.
    unseen_strain : by how many of its sigmas that would move the camera.
    unseen_motion : (p,) change of the camera's parameters by `unseen`, degrees and mm.
    """

    name: str
    chi_square_drop: float
    p_value: float
    estimate: Float[np.ndarray, "k"]
    sigma: Float[np.ndarray, "k"]
    sentence: str
    strain: float
    unseen: Float[np.ndarray, "k"]
    unseen_strain: float
    unseen_motion: Float[np.ndarray, "p"]

    @property
    def found(self) -> bool:
        """Whether noise alone would hardly make it."""
        return self.p_value < TUNING.answer.chance

    @property
    def is_strained(self) -> bool:
        """Whether noise alone would rarely make it, and it would move the camera far."""
        is_rare = self.p_value < TUNING.answer.chance_where_strained
        return is_rare and self.strain > TUNING.answer.strain_sigmas


class ImageQuality(Value):
    """What the fit of the picture's grey levels says about picture and fit.

    Fields
    ------
    noise : standard deviation of the residuals, grey levels.
    noise_floor : the same of the picture's flat parts, which no fit can go below; `noise` itself
        where it depends on the grey level, so that flat parts do not tell.
    pixels : number of pixels that took part.
    pixels_cut : number of pixels near an edge of the sheet that show something else.
    blur_px : sigma of the lens's blur.
    ink_spread_mm : by which ink reaches beyond the drawing.
    ink_over_paper : grey level of ink over that of paper.
    found : what the picture shows of its camera and its light, in words.
    """

    noise: float = eqx.field(static=True)
    noise_floor: float = eqx.field(static=True)
    pixels: int = eqx.field(static=True)
    pixels_cut: int = eqx.field(static=True)
    blur_px: float = eqx.field(static=True)
    ink_spread_mm: float = eqx.field(static=True)
    ink_over_paper: float = eqx.field(static=True)
    found: tuple[str, ...] = eqx.field(static=True)

    @property
    def reduced_chi_square(self) -> float:
        """Variance of the residuals over that of the noise: 1 for a model that is right."""
        return (self.noise / self.noise_floor) ** 2 if self.noise_floor > 0 else float("nan")


class CameraFit(Value):
    """What the fit of one camera's picture says about itself.

    Fields
    ------
    detection : the circles and lines it was fitted to.
    residuals_px : (m, 2) predicted minus observed centre of each circle of the detection.
    rank : of the column-scaled Jacobian.
    reduced_chi_square : of the circles' fit, chi-square over degrees of freedom.
    gauge : names of the parameters that the observations leave free.
    notes : sentences on what a user should know (covered circles, dropped outliers, ...).
    used : (m,) circles that took part in the fit; the others were located wrongly.
    image : of the fit to the grey levels, or None where the circles alone were fitted.
    alternatives : what the residuals say of everything that the model holds fixed.
    method : whether the answer is that of the grey levels ("pixels") or of the circles alone
        ("points").
    """

    detection: Detection
    residuals_px: Float[np.ndarray, "m 2"]
    rank: int = eqx.field(static=True)
    reduced_chi_square: float = eqx.field(static=True)
    gauge: tuple[str, ...] = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True)
    used: Bool[np.ndarray, "m"]
    image: ImageQuality | None = None
    alternatives: tuple[Alternative, ...] = ()
    method: str = eqx.field(static=True, default="points")

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the circles that took part."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px[self.used] ** 2, axis=1))))


class CalibrationResult(Displayable, Value):
    """A calibrated rig with parameters, covariance, and the fit of each camera.

    Fields
    ------
    rig : the cameras whose fit converged; its covariance holds the aims and lenses, too, where they
        are not exact.
    status : per camera, those that failed included.
    parameters : names such as "upper.pan_deg", the rows of `covariance`.
    values : (p,) of `parameters`, degrees and mm.
    covariance : (p, p), degrees and mm; NaN where a parameter is not determined.
    fits : per camera in which the sheet was found.
    pattern : the sheet.
    failures : for each camera that is not in the rig, a sentence that says why.
    systematics : the errors beyond noise that the covariance holds, in words.
    notes : sentences on what the pictures say of the sheet.
    advice : a sentence on what to know better, if that narrows the sigmas.
    """

    rig: Rig
    status: dict[str, Status]
    parameters: tuple[str, ...] = eqx.field(static=True)
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]
    fits: dict[str, CameraFit]
    pattern: Pattern
    failures: dict[str, str] = eqx.field(default_factory=dict)
    systematics: tuple[str, ...] = eqx.field(static=True, default=())
    notes: tuple[str, ...] = eqx.field(static=True, default=())
    advice: str = eqx.field(static=True, default="")

    def sigma(self, parameter: str) -> float:
        """Standard deviation of a parameter such as "upper.pan_deg"; NaN if not known."""
        return self.rig.sigma(parameter)

    def summary(self) -> str:
        """The parameters with their standard deviations, and how good each fit is, as text."""
        return summarise_calibration(self)


def summarise_calibration(result: CalibrationResult) -> str:
    """A table of one row per camera, above it what must not be overlooked, below it the rest."""
    values = dict(zip(result.parameters, result.values, strict=True))
    columns = [
        name
        for name in PARAMETER_NAMES
        if any(f"{camera}.{name}" in values for camera in result.rig.names)
    ]
    header = [
        "camera",
        *(name.replace("_deg", " (deg)").replace("_mm", " (mm)") for name in columns),
    ]
    rows = [[*header, "circles", "rms (px)", "noise/floor"]]
    remarks, warnings = [], []
    for camera, status in result.status.items():
        if camera not in result.rig.names:
            remarks.append(f"{camera}: {result.failures.get(camera, status.value)}")
            continue
        fit = result.fits[camera]
        cells = [
            _with_sigma(values[f"{camera}.{name}"], result.sigma(f"{camera}.{name}"))
            for name in columns
        ]
        found = f"{int(fit.used.sum())} of {len(result.pattern)}"
        rows.append([camera, *cells, found, f"{fit.rms_px:.4f}", _noise(fit)])
        remarks.extend(f"{camera}: {note}" for note in fit.notes)
        if status is Status.SUSPECT:
            warnings.append(f"SUSPECT {camera}: {fit.notes[0]}")
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    included = ", ".join(("noise", *result.systematics))
    advice = [result.advice] if result.advice else []
    said = [*warnings, *lines, f"sigmas include {included}.", *advice, *result.notes, *remarks]
    return "\n".join(said)


def _noise(fit: CameraFit) -> str:
    """Noise of the residuals over the picture's own, in grey levels."""
    if fit.image is None:
        return "circles only"
    return f"{fit.image.noise:.2f} / {fit.image.noise_floor:.2f}"


def _with_sigma(value: float, sigma: float) -> str:
    """Text "value +- sigma", rounded to two significant digits of the standard deviation."""
    if not np.isfinite(sigma) or sigma <= 0:
        return f"{value:.4f} +- ?"
    decimals = max(0, 1 - int(np.floor(np.log10(sigma))))
    return f"{value:.{decimals}f} +- {sigma:.{decimals}f}"
