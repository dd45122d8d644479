"""Slopes of grey levels beside lines: intensity ramps, and the shift of lines by shading.

Noise on an intensity ramp looks like short edges; such lines are rejected. A soft shadow near an
edge adds more slope to one side than to the other. The steepest position of the profile then shifts
to that side, by the difference of the slopes times the profile's variance over the height of the
step.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.image.strip import nearest_levels
from trinoc.segments.nevatia_babu.edge_points import Runs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT, AcceptTuning, ErrorTuning

# Side of the box that smooths the levels.
_BOX_PX = 3  # numerical: smallest box about a pixel


class Shifts(NamedTuple):
    """Corrections of the positions of lines.

    Attributes
    ----------
    shift_px : (r,)
        Displacement of the line toward the brighter side.
    variance_px2 : (r,)
        Variance of the displacement, which is equal for both ends.
    """

    shift_px: Float[np.ndarray, "r"]
    variance_px2: Float[np.ndarray, "r"]


class SideSlopes(NamedTuple):
    """Mean slopes of grey levels or light on and beside each line, grey levels per px.

    Slopes are positive toward the bright side of the line.

    Attributes
    ----------
    dark, bright : (r,)
        Slope on the dark side and on the bright side, beyond the blur of the edge.
    line : (r,)
        Slope on the line itself.
    """

    dark: Float[np.ndarray, "r"]
    bright: Float[np.ndarray, "r"]
    line: Float[np.ndarray, "r"]


def side_slopes(
    grey: Float[np.ndarray, "h w"],
    runs: Runs,
    usual_blur_px2: float,
    tuning: AcceptTuning = DEFAULT.accept,
) -> SideSlopes:
    """Measure the mean slope of the image on both sides of each line.

    `usual_blur_px2` is the typical blur variance of edges.
    """
    points = runs.points
    smooth = cv2.blur(grey, (_BOX_PX, _BOX_PX), borderType=cv2.BORDER_REPLICATE)
    inner_px = np.float32(tuning.beside_widths) * np.sqrt(
        points.kernel_variance_px2 + np.float32(usual_blur_px2)
    )
    width_px = tuning.beside_px
    outer_px = inner_px + np.float32(width_px)
    # Samples across the edge of each point, toward the brighter side.
    outer_dark, inner_dark, inner_bright, outer_bright = (
        nearest_levels(
            smooth, *(points.uv_px[:, k] + across_px * points.normal[:, k] for k in (0, 1))
        )
        for across_px in (-outer_px, -inner_px, inner_px, outer_px)
    )
    return SideSlopes(
        runs.mean(inner_dark - outer_dark) / width_px,
        runs.mean(outer_bright - inner_bright) / width_px,
        runs.mean(points.strength),
    )


def is_on_ramp(slopes: SideSlopes, tuning: AcceptTuning = DEFAULT.accept) -> Bool[np.ndarray, "r"]:
    """Return the mask of the lines on an intensity ramp, (r,).

    On a ramp, the slopes on both sides exceed a fraction of the slope on the line. Both sides are
    tested, because another edge nearby makes one side of a real edge steep.
    """
    return np.minimum(slopes.dark, slopes.bright) > tuning.ramp_slope * slopes.line


def shading_shifts(
    slopes: SideSlopes,
    lines: FittedLines,
    crowded: Float[np.ndarray, "r"],
    tuning: ErrorTuning = DEFAULT.errors,
) -> Shifts:
    """Compute the position corrections of lines shifted by shading, with their variance.

    Parameters
    ----------
    slopes : SideSlopes
        Slopes of the light.
    lines : FittedLines
        The lines.
    crowded : (r,)
        Share of each line's points with another line nearby. The step of that line would be
        mistaken for a slope.
    tuning : ErrorTuning
        Fraction of the predicted shift to correct, and its upper limit.

    Notes
    -----
    The difference of the slopes on both sides predicts the shift. The step hides the slope at the
    line itself, so only a fraction of the predicted shift is corrected. The sigma of the correction
    is the same fraction of the shift that the sum of both slopes would cause.
    """
    profile_px2 = lines.kernel_variance_px2 + np.maximum(lines.blur_px2, 0.0)
    per_slope = profile_px2 / np.maximum(lines.contrast * lines.light_per_level, 1e-6)
    limit_px = tuning.shade_most_px
    predicted_px = np.clip((slopes.dark - slopes.bright) * per_slope, -limit_px, limit_px)
    # The edge's blur extends to these positions as well. Without its part, the errors of blurred
    # edges would be reported too small.
    size = np.minimum((np.abs(slopes.dark) + np.abs(slopes.bright)) * per_slope, limit_px)
    shift = tuning.shade_share * predicted_px * (1 - crowded)
    return Shifts(shift, np.square(tuning.shade_share * size))
