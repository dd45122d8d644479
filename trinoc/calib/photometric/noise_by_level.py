"""The noise of a picture by its grey level, from what a fit leaves over."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics import MAD_TO_SIGMA

_BINS = 8
_FEWEST_PIXELS = 30
# Rounding to whole levels leaves this much, and a fit must not trust fewer.
LEAST_SIGMA = 0.3


def noise_by_level(
    level: Float[np.ndarray, "n"],
    residual: Float[np.ndarray, "n"],
    used: Bool[np.ndarray, "n"],
    at: Float[np.ndarray, "m"],
    *,
    robust: bool = False,
) -> Float[np.ndarray, "m"]:
    """Standard deviation of the noise at grey levels, linear in between in variance.

    level, residual : predicted by the fit, and left over; of `used` pixels.
    robust : by medians, where outliers are still among them.
    """
    seen, left = level[used], residual[used]
    if len(seen) < _FEWEST_PIXELS:
        return np.full(len(at), max(float(np.std(residual)), LEAST_SIGMA))
    low, high = np.percentile(seen, [2, 98])
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(seen, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    enough = np.flatnonzero(count >= _FEWEST_PIXELS)
    if not len(enough):
        return np.full(len(at), max(float(np.std(left)), LEAST_SIGMA))
    if robust:
        sizes = [np.median(np.abs(left[bins == k])) for k in enough]
        variance = (MAD_TO_SIGMA * np.array(sizes)) ** 2
    else:
        variance = (np.bincount(bins, left**2, minlength=_BINS) / np.maximum(count, 1))[enough]
    middles = 0.5 * (edges[1:] + edges[:-1])[enough]
    return np.maximum(np.sqrt(np.interp(at, middles, variance)), LEAST_SIGMA)
