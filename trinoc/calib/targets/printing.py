"""A sheet that suits a camera, a distance and a paper, and the sheet as a printer made it."""

import math
from typing import NamedTuple

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import InputError

# numerical: so far, in pitches, the lines of `Pattern.cross_grid` reach beyond the outer centres.
_LINES_BEYOND = 0.75


class SheetProposal(NamedTuple):
    """Sizes of a cross grid.

    Fields
    ------
    count : circles along each side; even, so that no line meets a circle.
    pitch_mm, radius_mm : distance of neighbours, and radius of a circle.
    circle_px : how wide a circle is in the picture of a camera square to the sheet.
    field_share : how much of the field's shorter side the sheet takes.
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
    """As many circles as are still 20 px wide, over 60 % of the field or the room on the paper.

    field_mm : width and height of what the camera sees at the distance of the sheet.
    size_px : (width, height) of its pictures.
    room_mm : for the drawing on the paper.
    tuning : every tuned constant of calibration; a benchmark or a study changes them.

    Raises InputError where circles would be under 10 px wide.
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
            f"A camera that sees {field_mm[0]:.3g} x {field_mm[1]:.3g} mm in {size_px[0]} x "
            f"{size_px[1]} pixels has no room for a sheet: check the distance, the angle and the "
            "size of the pictures."
        )
    raise InputError(
        f"A sheet of {side:.0f} mm would have circles less than {rules.least_px:.0f} px wide in "
        "the picture: take larger paper, or go nearer."
    )


class PrintedSheet(NamedTuple):
    """The sheet with its true size, and the sigma of its scale along X and Y, as shares."""

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
    """The pattern rescaled by its scale bars, which need not agree along X and Y.

    nominal_mm : lengths of the bars along X and along Y as drawn.
    measured_mm : the same as measured on the print, with a standard deviation of `sigma_mm`.
    tuning : every tuned constant of calibration; a benchmark or a study changes them.

    A circle printed at two scales is an ellipse; it keeps the mean radius, which is right to
    the square of their difference. Raises InputError for lengths that cannot be.
    """
    nominal, measured = np.array(nominal_mm, float), np.array(measured_mm, float)
    if not ((nominal > 0).all() and (measured > 0).all() and sigma_mm >= 0):
        raise InputError("The bars' lengths must be positive, and their sigma not negative.")
    scale = measured / nominal
    if (np.abs(scale - 1) > tuning.targets.largest_change).any():
        raise InputError(
            f"The bars were measured as {measured[0]:g} and {measured[1]:g} mm where the drawing "
            f"has {nominal[0]:g} and {nominal[1]:g} mm: check the unit and the bars' order."
        )
    printed = pattern.rescale(float(scale[0]), float(scale[1]))
    sigma_x, sigma_y = sigma_mm / nominal
    return PrintedSheet(printed, (float(sigma_x), float(sigma_y)))
