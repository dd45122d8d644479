"""How noisy the segments and the sheet really are, estimated and not assumed.

Helmert's estimator: the weighted squared residuals of a group over its redundancy, which is
its number of observations less the trace of its share in the estimate. Source: K.-R. Koch,
Parameter Estimation and Hypothesis Testing in Linear Models, 1999, section 3.6.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# 99.9 % of the squared distances of right fragments, chi-square with two degrees of freedom.
INLIER_SQUARED = 13.816
# Redundancy below which the sheet's claim is kept: the estimate would be off by 13 % or more.
FEWEST_FOR_SHEET = 30


class VarianceComponents(NamedTuple):
    """Factors on the claimed standard deviations, and which fragments they were taken from.

    A factor of 1 says that the claimed sigmas were right.
    """

    segments: float
    sheet: float
    inlier: Bool[np.ndarray, "t v"]


def segment_factor(
    squared: Float[np.ndarray, "t v"],
    seen: Bool[np.ndarray, "t v"],
    cameras_trace: float,
) -> tuple[float, Bool[np.ndarray, "t v"]]:
    """Factor on the sigma of segments from tracks whose every fragment fits.

    `cameras_trace` is the trace of the segments' share in the cameras' estimate. A track with
    n views leaves 2 n - 4 distances for the noise; two views leave none. With less than one in all
    the claimed sigmas are kept.
    """
    factor = 1.0
    for _ in range(10):
        inlier = seen & (squared <= INLIER_SQUARED * max(factor, 1e-3) ** 2)
        whole = (inlier == seen).all(axis=1) & (seen.sum(axis=1) >= 3)
        redundancy = (2 * seen[whole].sum(axis=1) - 4).sum() - cameras_trace
        if redundancy < 1:
            return 1.0, inlier
        update = float(np.sqrt(squared[whole].sum() / redundancy))
        if abs(update - factor) < 1e-4 * factor:
            break
        factor = update
    return factor, inlier


def sheet_factor(
    own_chi_square: float, own_redundancy: float, prior_chi_square: float, prior_redundancy: float
) -> float:
    """Factor on the sheet's sigmas from its own fit and from how far segments pulled it.

    With too little redundancy the claimed sigmas are kept: a factor from a handful of numbers
    would be noise itself.
    """
    redundancy = own_redundancy + prior_redundancy
    if redundancy < FEWEST_FOR_SHEET:
        return 1.0
    return float(np.sqrt((own_chi_square + prior_chi_square) / redundancy))
