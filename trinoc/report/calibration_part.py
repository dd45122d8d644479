"""What the page shows of a calibration: the parameters, and what was found in each picture."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib import CalibrationResult, CameraFit, Status
from trinoc.geometry import Rig
from trinoc.report.clipping import clip_line
from trinoc.report.numbers import plain, round_scale, signed, with_decimals
from trinoc.report.parameter_table import ParameterCell, parameter_rows
from trinoc.report.pictures import PagePicture, Window

# The longest residual arrow, as a share of the width of the part of the picture shown.
ARROW_REACH = 0.09


class CameraStatus(NamedTuple):
    """What one camera's fit says about itself, in sentences and in figures.

    verdict : "good", "suspect" or "failed".
    """

    name: str
    sentence: str
    verdict: str
    notes: tuple[str, ...]
    figures: tuple[tuple[str, str], ...]


# What each figure of a camera means, in the order of the cards.
MEANINGS = (
    ("circles used", "those found that agree with the others; the rest were located wrongly"),
    ("residual length, rms", "of the circles' centres, predicted minus observed"),
    ("chi-square of the circles / dof", "their squared residuals over their own noise: near 1"),
    ("rank", "number of parameters that the picture determines: all that are fitted"),
    ("noise left by the fit", "of the grey levels near edges: no more than the picture's own"),
    (
        "noise that is the picture's own",
        "that of flat paper, which no fit explains; paper is brighter than ink, and bright parts "
        "are the noisier ones. What is left by the fit where noise was fitted by level",
    ),
    ("pixels used, cut", "near edges of ink; cut where something else is seen, such as a thumb"),
    ("blur", "sigma of the lens's blur"),
    ("ink spread", "by which the ink reaches beyond the drawing"),
    (
        "sigma over least possible",
        "of the parameter that is worst off, beside what the noise of the pixels used alone would "
        "allow: 1 if nothing but noise counts, more where sheet, aim or lens are not exact",
    ),
)


class Ellipse(NamedTuple):
    """A circle's image: semi-axes in pixels, the angle of the first, the tip of its residual.

    A circle that is not `used` took no part in the fit.
    """

    u: float
    v: float
    semi_major_px: float
    semi_minor_px: float
    angle_deg: float
    tip: tuple[float, float]
    used: bool
    words: str


class DetectionFigure(NamedTuple):
    """Circles, cross lines and residual arrows over the picture of one camera."""

    name: str
    picture: PagePicture
    window: Window
    ellipses: tuple[Ellipse, ...]
    lines: tuple[Float[np.ndarray, "2 2"], ...]


class CalibrationPart(NamedTuple):
    """Everything of the page's first part; `status`, `figures` and `remarks` may be empty.

    remarks : sentences on what the sigmas include, and on the sheet.
    """

    names: tuple[str, ...]
    rows: tuple[tuple[str, tuple[ParameterCell, ...]], ...]
    reference_name: str
    status: tuple[CameraStatus, ...]
    figures: tuple[DetectionFigure, ...]
    arrow_magnification: str
    key_arrow_px: str
    key_arrow_length: float
    any_unused: bool
    sigmas_known: bool
    remarks: tuple[str, ...] = ()


def calibration_part(
    rig: Rig,
    result: CalibrationResult | None,
    pictures: dict[str, PagePicture],
    reference: Rig | None,
    reference_name: str,
) -> CalibrationPart:
    """The parameters of a rig and, where there is a calibration, what it was fitted to."""
    rows, known = parameter_rows(rig, reference), len(rig.parameters) > 0
    if result is None:
        return CalibrationPart(rig.names, rows, reference_name, (), (), "", "", 0.0, False, known)
    windows = {name: _window(fit, pictures[name]) for name, fit in result.fits.items()}
    magnification = _magnification(result, windows)
    width = min((window.width for window in windows.values()), default=1.0)
    key_px = round_scale(0.7 * ARROW_REACH * width / magnification)
    return CalibrationPart(
        rig.names,
        rows,
        reference_name,
        tuple(_status(result, name) for name in result.status),
        tuple(
            _figure(name, fit, pictures[name], windows[name], magnification)
            for name, fit in result.fits.items()
        ),
        plain(magnification),
        plain(key_px),
        key_px * magnification,
        any(not fit.used.all() for fit in result.fits.values()),
        known,
        (f"Sigmas include {', '.join(('noise', *result.systematics))}.", *result.notes),
    )


def _status(result: CalibrationResult, name: str) -> CameraStatus:
    status, failure = result.status[name], result.failures.get(name, "")
    if name not in result.fits:
        return CameraStatus(name, failure or status.value, "failed", (), ())
    fit = result.fits[name]
    lines = int(np.isfinite(fit.detection.lines_px).all(axis=1).sum())
    used = int(fit.used.sum())
    figures = (
        ("circles found", f"{len(fit.detection)} of {len(result.pattern)}"),
        ("circles used", f"{used} of {len(fit.detection)}"),
        ("cross lines found", f"{lines} of 2"),
        ("residual length, rms", f"{with_decimals(fit.rms_px if used else float('nan'), 4)} px"),
        ("chi-square of the circles / dof", with_decimals(fit.reduced_chi_square, 2)),
        ("rank", str(fit.rank)),
        *_picture_figures(result, name),
    )
    gauge = (f"Left free by the picture: {', '.join(fit.gauge)}.",) if fit.gauge else ()
    more = (failure,) if failure and failure != status.value else ()
    verdict = {Status.CONVERGED: "good", Status.SUSPECT: "suspect"}.get(status, "failed")
    return CameraStatus(name, status.value, verdict, more + gauge + fit.notes, figures)


def _picture_figures(result: CalibrationResult, name: str) -> tuple[tuple[str, str], ...]:
    """What the fit to the picture's grey levels says, where there was one."""
    quality = result.fits[name].image
    if quality is None:
        return ()
    rows = [k for k, words in enumerate(result.parameters) if words.startswith(f"{name}.")]
    variance = np.diagonal(result.covariance)[rows]
    # The aim, where it was fitted without being asked for, stands last. The bound is that of flat
    # paper's noise; where the pixels fitted are less noisy than it, they know more.
    quieter = min(1.0, quality.reduced_chi_square)
    bound = quieter * np.diagonal(quality.bound)[: len(variance)]
    # A picture without noise has no bound.
    bounded = variance.shape == bound.shape and bool((bound > 0).all())
    over_bound = np.sqrt(variance / bound).max() if bounded else np.nan
    return (
        ("noise left by the fit", f"{with_decimals(quality.noise, 2)} grey levels"),
        ("noise that is the picture's own", f"{with_decimals(quality.noise_floor, 2)} grey levels"),
        ("pixels used, cut", f"{quality.pixels:,}, {quality.pixels_cut:,}"),
        ("blur", f"{with_decimals(quality.blur_px, 3)} px"),
        ("ink spread", f"{with_decimals(quality.ink_spread_mm, 4)} mm"),
        ("sigma over least possible", with_decimals(float(over_bound), 2)),
    )


def _window(fit: CameraFit, picture: PagePicture) -> Window:
    """The part of the picture that holds the circles found."""
    detection = fit.detection
    reach = np.sqrt(np.diagonal(detection.shape_px2, axis1=1, axis2=2))
    corners = [detection.centres_px - reach, detection.centres_px + reach]
    return Window.around(np.concatenate(corners), picture)


def _magnification(result: CalibrationResult, windows: dict[str, Window]) -> float:
    """One scale for all cameras, so that arrows compare across the pictures."""
    longest = max(
        (
            float(np.linalg.norm(fit.residuals_px[fit.used], axis=1).max()) / windows[name].width
            for name, fit in result.fits.items()
            if fit.used.any()
        ),
        default=0.0,
    )
    return round_scale(ARROW_REACH / longest) if longest > 1e-12 else 1.0


def _figure(
    name: str, fit: CameraFit, picture: PagePicture, window: Window, magnification: float
) -> DetectionFigure:
    ellipses = tuple(_ellipse(fit, row, magnification) for row in range(len(fit.detection)))
    lines = tuple(
        ends
        for line in np.asarray(fit.detection.lines_px)
        if (ends := clip_line(line, fit.detection.image_size_px)) is not None
    )
    return DetectionFigure(name, picture, window, ellipses, lines)


def _ellipse(fit: CameraFit, row: int, magnification: float) -> Ellipse:
    detection, used = fit.detection, bool(fit.used[row])
    u, v = (float(value) for value in detection.centres_px[row])
    du, dv = (float(value) for value in fit.residuals_px[row])
    squared, axes = np.linalg.eigh(np.asarray(detection.shape_px2[row]))
    semi_minor, semi_major = (float(value) for value in np.sqrt(np.maximum(squared, 0)))
    words = (
        f"circle {int(detection.circle_index[row])}: residual ({signed(du, 4)}, {signed(dv, 4)}) "
        f"px at ({u:.2f}, {v:.2f}){'' if used else ', not used'}"
    )
    return Ellipse(
        u,
        v,
        semi_major,
        semi_minor,
        float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))),
        (u + magnification * du, v + magnification * dv),
        used,
        words,
    )
