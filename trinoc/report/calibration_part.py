"""Cameras with their parameters, and the detections in each image of the sheet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.result.calibration import CalibrationResult, CameraFit, ImageQuality, Status
from trinoc.calib.result.summary import fixed_boards
from trinoc.errors import list_names
from trinoc.geometry.rig import Rig
from trinoc.report.coverage import Coverage
from trinoc.report.numbers import with_decimals, with_sign
from trinoc.report.parameter_table import (
    boards_table,
    is_without_sheet,
    lens_table,
    pairs_table,
    rig_table,
)
from trinoc.report.pictures import Arrows, PagePicture, Window, clip_line
from trinoc.report.report_table import ReportTable

# The longest residual arrow, as a share of the width of the part of the picture shown.
ARROW_REACH = 0.09


class StatusRow(NamedTuple):
    """Status of one camera's calibration.

    Attributes
    ----------
    name : str
        Name of the camera.
    sentence : str
        Status as a sentence, or the reason of a failure.
    verdict : str
        "good", "suspect" or "failed".
    notes : tuple of str
        Sentences on the fit.
    figures : tuple of (name, value)
        Figures of the fit, as text.
    """

    name: str
    sentence: str
    verdict: str
    notes: tuple[str, ...]
    figures: tuple[tuple[str, str], ...]


# The meaning of each figure of a camera, in the order of the cards.
MEANINGS = (
    ("circles used", "circles that agree with the fit; the others were located wrongly"),
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
    ("ink spread", "width by which the ink extends beyond the drawing"),
)


class Ellipse(NamedTuple):
    """Image of one circle of the sheet, as a figure draws it.

    Attributes
    ----------
    u, v : float
        Centre of the ellipse, px.
    semi_major_px, semi_minor_px : float
        Semi-axes.
    angle_deg : float
        Angle of the major axis from u toward v.
    tip : (u, v)
        Tip of the arrow that shows the residual of the centre, px.
    used : bool
        False if the fit excluded the circle.
    description : str
        Text that appears when the reader points at the ellipse.
    """

    u: float
    v: float
    semi_major_px: float
    semi_minor_px: float
    angle_deg: float
    tip: tuple[float, float]
    used: bool
    description: str


class DetectionFigure(NamedTuple):
    """Figure of one camera's image with the detected circles, crossed lines and residual arrows.

    Attributes
    ----------
    name : str
        Name of the camera.
    picture : PagePicture
        The image.
    window : Window
        Part of the image that the figure shows.
    ellipses : tuple of Ellipse
        Images of the circles.
    lines : tuple of (2, 2)
        Ends of the crossed lines, px.
    caption : str
        Caption of the figure.
    """

    name: str
    picture: PagePicture
    window: Window
    ellipses: tuple[Ellipse, ...]
    lines: tuple[Float[np.ndarray, "2 2"], ...]
    caption: str


class CamerasPart(NamedTuple):
    """Section of the report with the parameters of cameras and boards.

    Attributes
    ----------
    parameters : ReportTable
        Parameters of the cameras.
    remarks : tuple of str
        Sentences about the table of parameters.
    status : tuple of StatusRow
        Status of each camera.
    meanings : tuple of (name, meaning)
        Explanations of the figures in `status`.
    pairs : ReportTable, optional
        Baselines and relative rotations of the pairs of cameras.
    fixed : tuple of str
        Sentences on the relative poses of boards that are fixed to each other.
    boards : ReportTable, optional
        Other estimated parameters of the boards.
    """

    parameters: ReportTable
    remarks: tuple[str, ...]
    status: tuple[StatusRow, ...] = ()
    meanings: tuple[tuple[str, str], ...] = ()
    pairs: ReportTable | None = None
    fixed: tuple[str, ...] = ()
    boards: ReportTable | None = None


class SheetPart(NamedTuple):
    """Section of the report with the coverage of each image by the sheet and the circles'
    residuals.

    Attributes
    ----------
    coverage : sequence of Coverage
        Coverage of each camera's image.
    figures : tuple of DetectionFigure
        Detected circles and residuals of each camera.
    arrows : Arrows
        Scale of the residual arrows.
    any_unused : bool
        True if a fit excluded a circle.
    """

    coverage: Sequence[Coverage]
    figures: tuple[DetectionFigure, ...]
    arrows: Arrows
    any_unused: bool


_DIGITS = "Value ± one sigma, with two digits of the sigma."


def cameras_part(
    rig: Rig,
    result: CalibrationResult | None,
    reference: Rig | None,
    reference_name: str,
    others: Sequence[str] = (),
) -> CamerasPart:
    """Section with the parameters of a rig and, if `result` is given, the status of each camera.

    rig : cameras that the section shows.
    result : calibration of the rig; None if it is unknown.
    reference : cameras with known parameters for comparison, called `reference_name`.
    others : names of further cameras of the rig, which the section omits.
    """
    parameters = rig_table(rig, reference)
    remarks = (_DIGITS,) if len(rig.parameters) else ("The sigmas are unknown.",)
    if is_without_sheet(rig):
        remarks += (
            "Not every optical axis meets the plane Z = 0: position and viewing direction in the "
            "world stand here in place of pan, tilt, swing and distance.",
        )
    if others:
        remarks += (f"Cameras without a view of this scene are left out: {list_names(others)}.",)
    if result is not None:
        remarks += (_sigmas_sentence(result), *result.notes)
    if any(cell.detail for row in parameters.cells() for cell in row):
        remarks += (
            f"Below it: {reference_name}, the error against it, and that error in sigmas; an error "
            "beyond 3 sigma is marked with an asterisk.",
        )
    if result is None:
        return CamerasPart(parameters, remarks)
    status = tuple(_status(result, name) for name in result.status)
    return CamerasPart(parameters, remarks, status, MEANINGS if result.fits else ())


def cameras_part_of_shots(result: CalibrationResult) -> CamerasPart:
    """Section with the parameters of lenses, cameras and boards of a rig from many shots."""
    return CamerasPart(
        lens_table(result),
        (_DIGITS, _sigmas_sentence(result), f"The world is {result.world}.", *result.notes),
        pairs=pairs_table(result),
        fixed=tuple(f"{sentence.replace('+-', '±')}." for sentence in fixed_boards(result)),
        boards=boards_table(result),
    )


def _sigmas_sentence(result: CalibrationResult) -> str:
    return f"Sigmas include {', '.join(('noise', *result.systematics))}."


def sheet_part(
    result: CalibrationResult, coverage: Sequence[Coverage], pictures: dict[str, PagePicture]
) -> SheetPart:
    """Section on every camera that detected the sheet.

    coverage : coverage of each camera's image. pictures : images by camera.
    """
    windows = {name: _window(fit, pictures[name]) for name, fit in result.fits.items()}
    arrows = Arrows.reaching(
        [
            (
                float(np.linalg.norm(fit.residuals_px[fit.used], axis=1).max()),
                ARROW_REACH * windows[name].width,
            )
            for name, fit in result.fits.items()
            if fit.used.any()
        ]
    )
    return SheetPart(
        coverage,
        tuple(
            _figure(name, fit, pictures[name], windows[name], arrows)
            for name, fit in result.fits.items()
        ),
        arrows,
        any(not fit.used.all() for fit in result.fits.values()),
    )


def _status(result: CalibrationResult, name: str) -> StatusRow:
    status, failure = result.status[name], result.failures.get(name, "")
    if name not in result.fits:
        return StatusRow(name, failure or status.value, "failed", (), ())
    fit = result.fits[name]
    line_count = int(np.isfinite(fit.detection.lines_px).all(axis=1).sum())
    used = int(fit.used.sum())
    figures = (
        ("circles found", f"{len(fit.detection)} of {len(result.pattern)}"),
        ("circles used", f"{used} of {len(fit.detection)}"),
        ("cross lines found", f"{line_count} of 2"),
        ("residual length, rms", f"{with_decimals(fit.rms_px if used else float('nan'), 4)} px"),
        ("chi-square of the circles / dof", with_decimals(fit.reduced_chi_square, 2)),
        ("rank", str(fit.rank)),
        *_picture_figures(fit.image),
    )
    gauge = (f"Left free by the picture: {', '.join(fit.gauge)}.",) if fit.gauge else ()
    failures = (failure,) if failure and failure != status.value else ()
    verdict = {Status.CONVERGED: "good", Status.SUSPECT: "suspect"}.get(status, "failed")
    return StatusRow(name, status.value, verdict, failures + gauge + fit.notes, figures)


def _picture_figures(quality: ImageQuality | None) -> tuple[tuple[str, str], ...]:
    """Figures of the fit to the image's grey levels; none without such a fit."""
    if quality is None:
        return ()
    return (
        ("noise left by the fit", f"{with_decimals(quality.noise, 2)} grey levels"),
        ("noise that is the picture's own", f"{with_decimals(quality.noise_floor, 2)} grey levels"),
        ("pixels used, cut", f"{quality.pixels:,}, {quality.pixels_cut:,}"),
        ("blur", f"{with_decimals(quality.blur_px, 3)} px"),
        ("ink spread", f"{with_decimals(quality.ink_spread_mm, 4)} mm"),
    )


def _window(fit: CameraFit, picture: PagePicture) -> Window:
    """Part of the image that contains the detected circles, with a margin."""
    detection = fit.detection
    half_size = np.sqrt(np.diagonal(detection.shape_px2, axis1=1, axis2=2))
    corners = [detection.centres_px - half_size, detection.centres_px + half_size]
    return Window.around(np.concatenate(corners), picture)


def _figure(
    name: str, fit: CameraFit, picture: PagePicture, window: Window, arrows: Arrows
) -> DetectionFigure:
    ellipses = tuple(_ellipse(fit, row, arrows) for row in range(len(fit.detection)))
    lines = tuple(
        ends
        for line in np.asarray(fit.detection.lines_px)
        if (ends := clip_line(line, fit.detection.image_size_px)) is not None
    )
    caption = f"{len(ellipses)} circles; part of the picture"
    return DetectionFigure(name, picture, window, ellipses, lines, caption)


def _ellipse(fit: CameraFit, row: int, arrows: Arrows) -> Ellipse:
    detection, used = fit.detection, bool(fit.used[row])
    u, v = (float(value) for value in detection.centres_px[row])
    du, dv = (float(value) for value in fit.residuals_px[row])
    squared, axes = np.linalg.eigh(np.asarray(detection.shape_px2[row]))
    semi_minor, semi_major = (float(value) for value in np.sqrt(np.maximum(squared, 0)))
    description = (
        f"circle {int(detection.circle_index[row])}: residual ({with_sign(du, 4)}, "
        f"{with_sign(dv, 4)}) px at ({u:.2f}, {v:.2f}){'' if used else ', not used'}"
    )
    return Ellipse(
        u,
        v,
        semi_major,
        semi_minor,
        float(np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))),
        arrows.tip((u, v), (du, dv)),
        used,
        description,
    )
