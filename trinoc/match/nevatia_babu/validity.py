"""Which fitted lines are sharp, straight edges of the scene."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.nevatia_babu.line_fit import FittedLines

# A profile this much wider than the picture's typical one is a soft shadow or shading.
SOFT_RATIO = 1.5
# A bow that noise does not explain, of a radius this small against the picture, is an arc.
ARC_BOW_PX = 0.25
ARC_RADIUS_OF_WIDTH = 0.2


def typical_variance(lines: FittedLines, kernel_variance_px2: float) -> float:
    """Variance of the profile of the picture's sharp edges: the median, longer lines weigh more."""
    if len(lines.support) == 0:
        return kernel_variance_px2
    order = np.argsort(lines.variance_px2)
    weight = np.cumsum(
        (lines.support * np.minimum(lines.strength, np.median(lines.strength)))[order]
    )
    middle = np.searchsorted(weight, weight[-1] / 2)
    return float(max(lines.variance_px2[order[middle]], kernel_variance_px2))


def is_sharp(lines: FittedLines, typical_px2: float) -> Bool[np.ndarray, "r"]:
    """Edges whose profile is about as narrow as the picture's typical one."""
    return lines.variance_px2 <= SOFT_RATIO * typical_px2


def is_straight(
    lines: FittedLines, sigma_px: Float[np.ndarray, "r"], width_px: int
) -> Bool[np.ndarray, "r"]:
    """Edges that are no arcs of small circles, such as the rims of cylinders."""
    length = np.ptp(lines.extent_px, axis=1)
    bow = np.abs(lines.bow_px)
    radius = length**2 / np.maximum(8 * bow, 1e-9)
    bent = (bow > ARC_BOW_PX) & (bow > 3 * sigma_px) & (radius < ARC_RADIUS_OF_WIDTH * width_px)
    return ~bent
