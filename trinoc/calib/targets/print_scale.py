"""The sheet as it was printed, from two bars measured with a rule."""

from typing import NamedTuple

import numpy as np

from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError

# Printers miss by a percent; a third of the length is a mistake of the person or the unit.
_LARGEST_CHANGE = 0.3


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
) -> PrintedSheet:
    """The pattern rescaled by its scale bars, which need not agree along X and Y.

    nominal_mm : lengths of the bars along X and along Y as drawn.
    measured_mm : the same as measured on the print, with a standard deviation of `sigma_mm`.

    A circle printed at two scales is an ellipse; it keeps the mean radius, which is right to
    the square of their difference. Raises InputError for lengths that cannot be.
    """
    nominal, measured = np.array(nominal_mm, float), np.array(measured_mm, float)
    if not ((nominal > 0).all() and (measured > 0).all() and sigma_mm >= 0):
        raise InputError("The bars' lengths must be positive, and their sigma not negative.")
    scale = measured / nominal
    if (np.abs(scale - 1) > _LARGEST_CHANGE).any():
        raise InputError(
            f"The bars were measured as {measured[0]:g} and {measured[1]:g} mm where the drawing "
            f"has {nominal[0]:g} and {nominal[1]:g} mm: check the unit and the bars' order."
        )
    mean = float(scale.mean())
    half_x, half_y = pattern.line_half_length_mm
    printed = Pattern(
        name=pattern.name,
        centres_mm=pattern.centres_mm * scale,
        radius_mm=pattern.radius_mm * mean,
        inner_radius_mm=pattern.inner_radius_mm * mean,
        lattice=pattern.lattice,
        line_width_mm=pattern.line_width_mm * mean,
        line_half_length_mm=(half_x * float(scale[0]), half_y * float(scale[1])),
        line_style=pattern.line_style,
        line_gap_mm=pattern.line_gap_mm * mean,
    )
    sigma_x, sigma_y = sigma_mm / nominal
    return PrintedSheet(printed, (float(sigma_x), float(sigma_y)))
