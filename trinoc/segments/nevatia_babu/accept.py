"""Which fitted lines are sharp, straight edges of the scene, and more than noise.

The evidence of a line is E = n (m / s)^2 for n edge points of mean strength m, where s is
the standard deviation of the gradient that noise alone gives. On pictures of white noise the
number of lines per megapixel whose evidence exceeds E falls as RATE exp(-E / DECAY); both
numbers were fitted to such pictures (benchmarks/segments.py repeats the measurement) and
hold for point thresholds of 2.5 s and above.

Slopes of grey levels beside lines: which lines are only slopes, and how far slopes move others.

Noise on a slope of grey levels looks like short edges. And a soft shadow that ends near an edge of
the scene, or lies on both its sides by other reflectances, adds more slope to one side than to the
other: the steepest place of the profile moves to that side, by the difference of the slopes times
the profile's variance over the height of the step.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.strip import nearest_levels
from trinoc.numerics.joins import near_pairs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.runs import Runs
from trinoc.segments.tuning import DEFAULT, AcceptTuning, ErrorTuning

# Levels are smoothed by a box with this side.
_BOX_PX = 3  # numerical: the least box about a pixel


class Shifts(NamedTuple):
    """How far lines are to be moved.

    Fields
    ------
    shift_px : (r,) toward the brighter side.
    variance_px2 : (r,) of that shift, which both ends have in common.
    """

    shift_px: Float[np.ndarray, "r"]
    variance_px2: Float[np.ndarray, "r"]


class SideSlopes(NamedTuple):
    """Of each line, mean slopes toward its bright side, in grey levels per pixel.

    Fields
    ------
    dark, bright : (r,) beside it on either side.
    own : (r,) on the line itself.
    """

    dark: Float[np.ndarray, "r"]
    bright: Float[np.ndarray, "r"]
    own: Float[np.ndarray, "r"]


def side_slopes(
    grey: Float[np.ndarray, "h w"],
    runs: Runs,
    usual_blur_px2: float,
    tuning: AcceptTuning = DEFAULT.accept,
) -> SideSlopes:
    """Slopes of grey levels or light beside the lines of runs."""
    points = runs.points
    smooth = cv2.blur(grey, (_BOX_PX, _BOX_PX), borderType=cv2.BORDER_REPLICATE)
    near = np.float32(tuning.beside_widths) * np.sqrt(
        points.kernel_variance_px2 + np.float32(usual_blur_px2)
    )
    further = tuning.beside_px
    far = near + np.float32(further)
    # So far from each point across its edge, toward the brighter side.
    far_dark, near_dark, near_bright, far_bright = (
        nearest_levels(
            smooth, *(points.uv_px[:, k] + across_px * points.normal[:, k] for k in (0, 1))
        )
        for across_px in (-far, -near, near, far)
    )
    return SideSlopes(
        runs.mean(near_dark - far_dark) / further,
        runs.mean(far_bright - near_bright) / further,
        runs.mean(points.strength),
    )


def is_on_ramp(slopes: SideSlopes, tuning: AcceptTuning = DEFAULT.accept) -> Bool[np.ndarray, "r"]:
    """Lines whose slope goes on beyond both sides, by `ramp_slope` of what it is on the line.

    Both sides must show it: another edge beside an edge of the scene makes one side steep.
    """
    return np.minimum(slopes.dark, slopes.bright) > tuning.ramp_slope * slopes.own


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
    taken, and as large a part of their size stays as an error.
    """
    profile_px2 = lines.kernel_variance_px2 + np.maximum(lines.blur_px2, 0.0)
    per_slope = profile_px2 / np.maximum(lines.contrast * lines.light_per_level, 1e-6)
    most = tuning.shade_most_px
    promised = np.clip((slopes.dark - slopes.bright) * per_slope, -most, most)
    # The edge's own blur reaches so far, too. Without its part the errors of blurred edges are
    # claimed too small.
    size = np.minimum((np.abs(slopes.dark) + np.abs(slopes.bright)) * per_slope, most)
    shift = tuning.shade_share * promised * (1 - crowded)
    return Shifts(shift, np.square(tuning.shade_share * size))


_RATE_PER_MEGAPIXEL, _DECAY = 4.2e4, 12.0  # numerical: fitted to white noise, as above
# Noise moves the bow of a line this many times more than its middle: the parabola has to be
# told from the line.
BOW_OF_MIDDLE = float(np.sqrt(11.25))  # numerical: moments of a parabola
# Root mean square distance of a parabola from its best line, over its bow.
_RMS_OF_BOW = float(np.sqrt(4 / 45))  # numerical: moments of a parabola


def typical_blur(lines: FittedLines) -> float:
    """Variance of the blur of the picture's edges, in px^2: the median, long lines weigh more."""
    if len(lines.support) == 0:
        return 0.0
    return max(_quantile(lines.blur_px2, lines.support, 0.5), 0.0)


def _quantile(values: Float[np.ndarray, "r"], weights: Int[np.ndarray, "r"], share: float) -> float:
    """The least value that, with all below it, has such a share of the weights."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])


def is_sharp(
    lines: FittedLines, usual_px2: float, tuning: AcceptTuning = DEFAULT.accept
) -> Bool[np.ndarray, "r"]:
    """Edges that are no soft shadows: hardly wider than usual, for how much widths vary.

    Where the edges of a picture have many widths, as with depth or texture, a wide one is no
    evidence of a shadow: the limit follows the spread of the widths. The spread is that of the
    narrower half of clear lines. Shadows are among the wider half, and noise scatters the widths
    of faint lines.
    """
    ratio = lines.kernel_variance_px2 + lines.blur_px2
    ratio /= lines.kernel_variance_px2 + usual_px2
    limit = tuning.soft_ratio
    clear = lines.snr2 > np.square(tuning.clear_ratio) * lines.support
    if clear.any():
        low, middle = (_quantile(ratio[clear], lines.support[clear], q) for q in (0.25, 0.5))
        limit = max(limit, 1 + tuning.soft_spreads * (middle - low))
    return ratio <= limit


def is_straight(lines: FittedLines, tuning: AcceptTuning = DEFAULT.accept) -> Bool[np.ndarray, "r"]:
    """Edges that are no pieces of curves, such as the rims of cylinders.

    The points of an arc lie on it: where a curve explains little of how they scatter about the
    line, and bows it little, it counts as straight. A bow alone shows no curve: lenses bend
    straight edges, and edges of real things are bent.
    """
    length = lines.pieces.length_px
    bow = np.abs(lines.sagitta_px)
    sigma = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    arc = (bow > 2 * sigma) & _continues_curve(lines, tuning)
    explained = np.square(_RMS_OF_BOW * bow) / np.maximum(np.square(lines.residual_px), 1e-12)
    ragged = (explained < tuning.arc_explains) & (bow < tuning.arc_bow_of_length * length)
    return ~arc | ragged


def _continues_curve(lines: FittedLines, tuning: AcceptTuning) -> Bool[np.ndarray, "r"]:
    """Whether a piece before or after continues the curve of each line."""
    bends = np.zeros(len(lines.support), dtype=bool)
    ends = lines.pieces.ends_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], tuning.next_px)
    a, b = lines.direction[one], lines.direction[other]
    sine, cosine = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
    turn = np.arctan2(sine, cosine)
    length = lines.pieces.length_px
    between = (length[one] + length[other]) / 2 + gap
    curvature = 8 * lines.sagitta_px / np.maximum(length, 1.0) ** 2
    least, most = np.radians(tuning.turn_deg)
    turning = (np.abs(turn) > least) & (np.abs(turn) < most) & (one != other)
    for line in (one, other):
        ratio = turn / (curvature[line] * between + 1e-12)
        promised = (ratio > 1 / tuning.turn_ratio) & (ratio < tuning.turn_ratio)
        bends[line[turning & promised]] = True
    return bends


def least_snr2(false_alarms: float, pixels: int) -> float:
    """Evidence that noise exceeds `false_alarms` times, on average, in so many pixels."""
    return _DECAY * float(np.log(max(_RATE_PER_MEGAPIXEL * pixels / 1e6 / false_alarms, 1.0)))
