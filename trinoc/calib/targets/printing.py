"""Sheet sizes for a given camera and paper, and correction of a sheet for its printed size."""

import math
from typing import NamedTuple

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError

# numerical: length of the lines of `Pattern.cross_grid` beyond the outer centres, in pitches.
_LINES_BEYOND = 0.75


class SheetProposal(NamedTuple):
    """Proposed sizes for `Pattern.cross_grid`.

    Attributes
    ----------
    count : number of circles along each side; even, so that no line meets a circle.
    pitch_mm : distance between neighbouring circle centres.
    radius_mm : radius of a circle.
    circle_px : diameter of a circle's image, for a camera that looks perpendicularly at the sheet.
    field_share : side of the sheet divided by the shorter side of the field of view.
    """

    count: int
    pitch_mm: float
    radius_mm: float
    circle_px: float
    field_share: float


def propose_sheet(
    *,
    field_mm: tuple[float, float],
    size_px: tuple[int, int],
    room_mm: tuple[float, float],
    tuning: CalibTuning = TUNING,
) -> SheetProposal:
    """Propose the sheet with the most circles whose images are still about 20 px wide.

    The sheet covers 60 % of the shorter side of the field of view, or the paper if that is smaller.

    Parameters
    ----------
    field_mm : width and height of the field of view at the distance of the sheet.
    size_px : (width, height) of the camera's images.
    room_mm : (width, height) of the printable area of the paper.
    tuning : tuned constants of calibration; only benchmarks and studies change them.

    Raises
    ------
    InputError : the images of the circles would be less than 10 px wide.
    """
    rules = tuning.targets
    side = min(rules.field_share * min(field_mm), *room_mm)
    px_per_mm = min(size / field for size, field in zip(size_px, field_mm, strict=True))
    for count in (12, 10, 8, 6):
        extent = count - 1 + 2 * _LINES_BEYOND
        pitch = rules.step_mm * math.floor(side / extent / rules.step_mm)
        width = 2 * rules.radius_share * pitch * px_per_mm
        if width >= (rules.good_px if count > 6 else rules.least_px):
            share = extent * pitch / min(field_mm)
            return SheetProposal(count, pitch, rules.radius_share * pitch, width, share)
    if rules.field_share * min(field_mm) < min(room_mm):
        raise InputError(
            f"A camera with a field of {field_mm[0]:.3g} x {field_mm[1]:.3g} mm in {size_px[0]} x "
            f"{size_px[1]} pixels has no room for a sheet: check the distance, the angle and the "
            "size of the images."
        )
    raise InputError(
        f"A sheet of {side:.0f} mm would have circles less than {rules.least_px:.0f} px wide in "
        "the image: use larger paper, or move the camera nearer."
    )


class PrintedSheet(NamedTuple):
    """Sheet with the sizes of its print.

    Attributes
    ----------
    pattern : the sheet with its printed size.
    scale_sigma : relative standard deviations of the print's scale along X and along Y.
    """

    pattern: Pattern
    scale_sigma: tuple[float, float]


def printed_sheet(
    pattern: Pattern,
    *,
    nominal_mm: tuple[float, float],
    measured_mm: tuple[float, float],
    sigma_mm: float = 0.1,
    tuning: CalibTuning = TUNING,
) -> PrintedSheet:
    """Rescale a pattern along X and along Y by the measured lengths of its two scale bars.

    Parameters
    ----------
    pattern : the sheet as drawn.
    nominal_mm : lengths of the bars along X and along Y in the drawing.
    measured_mm : lengths of the same bars measured on the print.
    sigma_mm : standard deviation of the measured lengths.
    tuning : tuned constants of calibration; only benchmarks and studies change them.

    Raises
    ------
    InputError : a length is not positive, or a bar differs by over 30 % from its nominal length.

    Notes
    -----
    A circle printed at two scales is an ellipse. It keeps the geometric mean radius. The error is
    of second order in the difference of the scales.
    """
    nominal, measured = np.array(nominal_mm, float), np.array(measured_mm, float)
    if not ((nominal > 0).all() and (measured > 0).all() and sigma_mm >= 0):
        raise InputError("The lengths of the bars must be positive and their sigma not negative.")
    scale = measured / nominal
    if (np.abs(scale - 1) > tuning.targets.largest_change).any():
        raise InputError(
            f"The bars were measured as {measured[0]:g} and {measured[1]:g} mm where the drawing "
            f"has {nominal[0]:g} and {nominal[1]:g} mm: check the unit and the order of the bars."
        )
    printed = pattern.rescale(float(scale[0]), float(scale[1]))
    sigma_x, sigma_y = sigma_mm / nominal
    return PrintedSheet(printed, (float(sigma_x), float(sigma_y)))
