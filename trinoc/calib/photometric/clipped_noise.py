"""A noisy grey level that saturation cuts off: its expectation, slope and standard deviation."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

# Standard deviation of a level that is always cut off: of the model, since noise has none.
_CUT_OFF_LEVELS = 0.2
# A level is piled up where this share of the pixels holds it.
_PILED_SHARE = 0.002
_CLEAR_SIGMAS = 2.0


class Clipped(NamedTuple):
    """Of min(x, top) for a normal x.

    Fields
    ------
    mean : expectation.
    slope : its derivative by the mean of x.
    sigma : standard deviation.
    """

    mean: Float[np.ndarray, "n"]
    slope: Float[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n"]


def clipped(level: Float[np.ndarray, "n"], sigma: Float[np.ndarray, "n"], top: float) -> Clipped:
    """Moments of a level with noise, cut off at `top` (infinity: nowhere)."""
    if not np.isfinite(top):
        return Clipped(level, np.ones_like(level), sigma)
    z = (top - level) / sigma
    below, density = ndtr(z), np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
    mean = level * below + top * (1 - below) - sigma * density
    square = (level**2 + sigma**2) * below + top**2 * (1 - below) - sigma * (level + top) * density
    variance = np.maximum(square - mean * mean, 0.0) + (1 - below) * _CUT_OFF_LEVELS**2
    return Clipped(mean, below, np.sqrt(variance))


def is_clear(
    level: Float[np.ndarray, "n"], sigma: Float[np.ndarray, "n"], top: float
) -> np.ndarray:
    """Whether saturation leaves the noise of a level as it is."""
    return level < top - _CLEAR_SIGMAS * sigma


def saturation_level(grey: Float[np.ndarray, "n"]) -> float:
    """The largest grey level, if pixels pile up there as saturated ones do; else infinity."""
    top = float(grey.max())
    return top if np.mean(grey >= top - 0.5) > _PILED_SHARE else np.inf


def white_of(image: Float[np.ndarray, "h w"]) -> float:
    """Grey level of a full signal: of the fewest bits that hold the picture, 8 at least."""
    return float(2 ** max(int(np.ceil(np.log2(float(image.max()) + 1))), 8) - 1)
