"""Slopes of grey levels beside lines: which lines are only slopes, and how far slopes move others.

Noise on a slope of grey levels looks like short edges. And a soft shadow that ends near an edge of
the scene, or lies on both its sides by other reflectances, adds more slope to one side than to the
other: the steepest place of the profile moves to that side, by the difference of the slopes times
the profile's variance over the height of the step.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.image import nearest_levels
from trinoc.segments.nevatia_babu.edge_points import Runs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT, ErrorTuning

# Beside an edge the grey levels are compared from here, in widths of its profile, to so many
# pixels farther out.
_FROM_WIDTHS, _FURTHER_PX = 1.5, 3.0
# Beside an edge the grey levels are flat; in a soft shadow they slope on both sides.
_MOST_SLOPE = 0.25
_BOX = (3, 3)
# Of so many points next to each other the smoothed levels are one answer.
_ALIKE = 3


class Shifts(NamedTuple):
    """How far lines are to be moved.

    Fields
    ------
    shift_px : (r,) toward the brighter side.
    variance_px2 : (r,) of that shift, which both ends have in common.
    uneven_px2 : (r,) of the line's middle, as if points scattered: the shift changes along it.
    """

    shift_px: Float[np.ndarray, "r"]
    variance_px2: Float[np.ndarray, "r"]
    uneven_px2: Float[np.ndarray, "r"]


class SideSlopes(NamedTuple):
    """Of each line, mean slopes toward its bright side, in grey levels per pixel.

    Fields
    ------
    dark, bright : (r,) beside it on either side.
    sigma : (r,) of the difference, from how it scatters along the line.
    own : (r,) on the line itself.
    """

    dark: Float[np.ndarray, "r"]
    bright: Float[np.ndarray, "r"]
    sigma: Float[np.ndarray, "r"]
    own: Float[np.ndarray, "r"]


def side_slopes(grey: Float[np.ndarray, "h w"], runs: Runs, usual_blur_px2: float) -> SideSlopes:
    """Slopes of grey levels or light beside the lines of runs."""
    points = runs.points
    smooth = cv2.blur(grey, _BOX, borderType=cv2.BORDER_REPLICATE)
    near = np.float32(_FROM_WIDTHS) * np.sqrt(
        points.kernel_variance_px2 + np.float32(usual_blur_px2)
    )

    def level(across_px: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """So far from each point across its edge, toward the brighter side."""
        return nearest_levels(smooth, *(points.uv_px + across_px[:, None] * points.normal).T)

    far = near + np.float32(_FURTHER_PX)
    dark, bright = level(-near) - level(-far), level(far) - level(near)
    of_dark, of_bright = runs.mean(dark), runs.mean(bright)
    square = runs.mean(np.square(bright - dark)) - np.square(of_bright - of_dark)
    variance = np.maximum(square, 0.0) / np.maximum(runs.count / _ALIKE, 1.0)
    return SideSlopes(
        of_dark / _FURTHER_PX,
        of_bright / _FURTHER_PX,
        np.sqrt(variance) / _FURTHER_PX,
        runs.mean(points.strength),
    )


def is_on_ramp(slopes: SideSlopes) -> Bool[np.ndarray, "r"]:
    """Lines whose slope goes on beyond both sides, by `_MOST_SLOPE` of what it is on the line.

    Both sides must show it: another edge beside an edge of the scene makes one side steep.
    """
    return np.minimum(slopes.dark, slopes.bright) > _MOST_SLOPE * slopes.own


def shading_shifts(
    slopes: SideSlopes,
    lines: FittedLines,
    crowded: Float[np.ndarray, "r"],
    tuning: ErrorTuning = DEFAULT.errors,
) -> Shifts:
    """How far to move lines that shading has moved, and what is not known of it.

    `slopes` are of the light in which lines were placed; `crowded` is the share of each line's
    points that have another line within reach, whose step is no slope.

    The slopes on the line itself are not seen: part of the shift that those beside it promise is
    taken, beyond one standard deviation of noise, and part of their size stays as an error.
    """
    profile_px2 = lines.kernel_variance_px2 + np.maximum(lines.blur_px2, 0.0)
    per_slope = profile_px2 / np.maximum(lines.contrast * lines.light_per_level, 1e-6)
    most = tuning.shade_most_px
    promised = slopes.bright - slopes.dark
    beyond = np.maximum(np.abs(promised) - slopes.sigma, 0.0) * per_slope
    # The edge's own blur reaches so far, too. Without its part the errors of blurred edges are
    # claimed too small.
    size = np.maximum(np.abs(slopes.dark) + np.abs(slopes.bright) - slopes.sigma, 0.0) * per_slope
    shift = -tuning.shade_shift * np.sign(promised) * np.minimum(beyond, most) * (1 - crowded)
    variance = np.square(tuning.shade_share * np.minimum(size, most))
    return Shifts(shift, variance, np.zeros_like(shift))
