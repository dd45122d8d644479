"""Which fitted lines are sharp, straight edges of the scene."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool
from scipy.spatial import KDTree

from trinoc.match.nevatia_babu.line_fit import FittedLines

# A profile this much wider than the picture's typical one is a soft shadow or shading.
SOFT_RATIO = 1.5
SOFT_SPREAD = 1.5
# Noise moves the bow of a line this many times more than its middle: the parabola has to be
# told from the line.
BOW_OF_MIDDLE = float(np.sqrt(11.25))
# A bow of more than this is an arc whatever its neighbours do, if its radius is small.
ARC_BOW_PX = 0.8
ARC_RADIUS_OF_WIDTH = 0.2
# Pieces of one arc turn from each to the next by what their bows promise.
LEAST_BOW_PX = 0.4
NEXT_PX = 6.0
LEAST_TURN, MOST_TURN = np.radians(6.0), np.radians(60.0)
TURN_RATIO = 2.5


class BlurOfPicture(NamedTuple):
    """What blur the edges of a picture have, as variances in px^2: median and quartiles."""

    lower: float
    typical: float
    upper: float


def blur_of_picture(lines: FittedLines) -> BlurOfPicture:
    """Quartiles of the blur of the picture's edges; long lines weigh more."""
    if len(lines.support) == 0:
        return BlurOfPicture(0.0, 0.0, 0.0)
    order = np.argsort(lines.blur_px2)
    weight = np.cumsum(lines.support[order])
    place = np.searchsorted(weight, weight[-1] * np.array([0.25, 0.5, 0.75]))
    lower, typical, upper = lines.blur_px2[order[place]]
    return BlurOfPicture(float(lower), max(float(typical), 0.0), float(upper))


def is_sharp(lines: FittedLines, blur: BlurOfPicture) -> Bool[np.ndarray, "r"]:
    """Edges whose profile is about as narrow as one of the picture's usual blur.

    What is usual follows the spread of the picture: a photograph with depth has edges of
    several widths, a rendered scene has one.
    """
    usual = lines.kernel_variance_px2 + blur.typical
    spread = lines.kernel_variance_px2 + blur.upper + SOFT_SPREAD * (blur.upper - blur.lower)
    return lines.kernel_variance_px2 + lines.blur_px2 <= np.maximum(SOFT_RATIO * usual, spread)


def is_straight(lines: FittedLines, width_px: int) -> Bool[np.ndarray, "r"]:
    """Edges that are no arcs, such as the rims of cylinders."""
    length = np.ptp(lines.extent_px, axis=1)
    bow = np.abs(lines.bow_px)
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
    pairs = KDTree(ends[:, 1]).sparse_distance_matrix(
        KDTree(ends[:, 0]), NEXT_PX, output_type="coo_matrix"
    )
    one, other = pairs.row, pairs.col
    a, b = lines.direction[one], lines.direction[other]
    turn = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=-1))
    length = np.ptp(lines.extent_px, axis=1)
    between = (length[one] + length[other]) / 2 + pairs.data
    curvature = 8 * lines.bow_px / np.maximum(length, 1.0) ** 2
    turning = (np.abs(turn) > LEAST_TURN) & (np.abs(turn) < MOST_TURN) & (one != other)
    for line in (one, other):
        ratio = turn / (curvature[line] * between + 1e-12)
        bends[line[turning & (ratio > 1 / TURN_RATIO) & (ratio < TURN_RATIO)]] = True
    return bends
