"""Which fitted lines are sharp, straight edges of the scene."""

import numpy as np
from jaxtyping import Bool

from trinoc.numerics import near_pairs
from trinoc.segments.nevatia_babu.line_fit import FittedLines

# A profile this much wider than is typical of the image is a soft shadow or shading,
SOFT_RATIO = 1.5
# unless its blur has less than this variance: photographs with depth have edges of many widths.
SHARP_PX2 = 2.0
# Noise gives the sagitta of a line this many times the standard deviation of its middle.
BOW_OF_MIDDLE = float(np.sqrt(11.25))
# A larger sagitta is an arc whatever its neighbours do, if its radius is small.
ARC_BOW_PX = 0.8
ARC_RADIUS_OF_WIDTH = 0.2
# Pieces of one arc turn from each to the next by the angle that follows from their sagittas.
LEAST_BOW_PX = 0.2
NEXT_PX = 6.0
LEAST_TURN, MOST_TURN = np.radians(6.0), np.radians(60.0)
TURN_RATIO = 2.5


def typical_blur(lines: FittedLines) -> float:
    """Variance of the blur of the picture's edges, in px^2: the median, long lines weigh more."""
    if len(lines.support) == 0:
        return 0.0
    order = np.argsort(lines.blur_px2)
    weight = np.cumsum(lines.support[order])
    middle = np.searchsorted(weight, weight[-1] / 2)
    return max(float(lines.blur_px2[order[middle]]), 0.0)


def is_sharp(lines: FittedLines, usual_px2: float) -> Bool[np.ndarray, "r"]:
    """Edges that are no soft shadows: of about the image's typical width, or narrow anyway."""
    profile = lines.kernel_variance_px2 + lines.blur_px2
    usual = SOFT_RATIO * (lines.kernel_variance_px2 + usual_px2)
    return profile <= np.maximum(usual, lines.kernel_variance_px2 + SHARP_PX2)


def is_straight(lines: FittedLines, width_px: int) -> Bool[np.ndarray, "r"]:
    """Edges that are no arcs, such as the rims of cylinders."""
    length = np.ptp(lines.extent_px, axis=1)
    bow = np.abs(lines.sagitta_px)
    sigma = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    radius = length**2 / np.maximum(8 * bow, 1e-9)
    arc = (bow > ARC_BOW_PX) & (bow > 3 * sigma) & (radius < ARC_RADIUS_OF_WIDTH * width_px)
    curved = np.flatnonzero((bow > LEAST_BOW_PX) & (bow > 2 * sigma))
    arc[curved] |= _bends_on(lines)[curved]
    return ~arc


def _bends_on(lines: FittedLines) -> Bool[np.ndarray, "r"]:
    """Whether a piece before or after continues the curve of each line."""
    bends = np.zeros(len(lines.support), dtype=bool)
    if len(bends) < 2:
        return bends
    ends = lines.endpoints_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], NEXT_PX)
    a, b = lines.direction[one], lines.direction[other]
    sine, cosine = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
    turn = np.arctan2(sine, cosine)
    length = np.ptp(lines.extent_px, axis=1)
    between = (length[one] + length[other]) / 2 + gap
    curvature = 8 * lines.sagitta_px / np.maximum(length, 1.0) ** 2
    turning = (np.abs(turn) > LEAST_TURN) & (np.abs(turn) < MOST_TURN) & (one != other)
    for line in (one, other):
        ratio = turn / (curvature[line] * between + 1e-12)
        bends[line[turning & (ratio > 1 / TURN_RATIO) & (ratio < TURN_RATIO)]] = True
    return bends
