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
    """Corrections of line positions.

    Attributes
    ----------
    shift_px : (r,)
        Displacement toward the brighter side.
    variance_px2 : (r,)
        Variance of the displacement, common to both ends.
    """

    shift_px: Float[np.ndarray, "r"]
    variance_px2: Float[np.ndarray, "r"]


class SideSlopes(NamedTuple):
    """Mean slopes of the light toward the bright side of each line, grey levels per px.

    Attributes
    ----------
    dark, bright : (r,)
        Beside the line, on the dark and on the bright side.
    line : (r,)
        On the line itself.
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
    """Measure the slopes of grey levels or light beside the lines of runs."""
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
    """Mask of the lines on an intensity ramp: both side slopes exceed a share of the line's slope.

    Both sides are tested, because another edge beside an edge of the scene makes one side steep.
    """
    return np.minimum(slopes.dark, slopes.bright) > tuning.ramp_slope * slopes.line


def shading_shifts(
    slopes: SideSlopes,
    lines: FittedLines,
    crowded: Float[np.ndarray, "r"],
    tuning: ErrorTuning = DEFAULT.errors,
) -> Shifts:
    """Corrections of lines shifted by shading, with the remaining variance.

    Parameters
    ----------
    slopes : SideSlopes
        Slopes of the light in which the lines were located.
    lines : FittedLines
        Lines of the slopes.
    crowded : (r,)
        Share of each line's points with another line nearby, whose step would count as a slope.
    tuning : ErrorTuning
        Shares and limit.

    Notes
    -----
    The slopes at the line itself are hidden by the step. So only a share of the shift predicted
    from both sides is corrected, and the same share of the slopes' size counts as error.
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
