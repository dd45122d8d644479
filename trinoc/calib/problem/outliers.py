"""Circles that were located wrongly: found by a robust fit, dropped, and counted."""

import numpy as np
from jaxtyping import Bool, Float

# Length of a whitened two-dimensional error: median under a normal law, and the gate that a
# right circle exceeds once in 10^8.
_MEDIAN_LENGTH = 1.1774
GATE = 6.0
# Scales, in robust standard deviations, at which the influence of a circle is bounded.
ANNEALING = (30.0, 10.0, 5.0)


def robust_scale(whitened: Float[np.ndarray, "m 2"]) -> float:
    """Standard deviation of whitened errors by their median length; at least 1."""
    if not len(whitened):
        return 1.0
    return max(1.0, float(np.median(np.linalg.norm(whitened, axis=1))) / _MEDIAN_LENGTH)


def inliers(whitened: Float[np.ndarray, "m 2"]) -> Bool[np.ndarray, "m"]:
    """Circles whose error is one that noise can make."""
    return np.linalg.norm(whitened, axis=1) <= GATE * robust_scale(whitened)
