"""The picture at full and at half resolution.

The fine level places edges well and parts neighbours; the coarse one averages four pixels
into one and so sees edges of half the contrast. It serves where the fine level sees nothing.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.numerics import noise_sigma
from trinoc.segments.nevatia_babu.masks import GradientKernel

# Rows enough for a noise good to one part in a hundred; more would only cost time.
_MOST_ROWS = 60
_QUANTISATION_SIGMA = float(np.sqrt(1 / 12))
# Pictures of real numbers are taken to be good to this share of their range.
_LEAST_OF_RANGE = 1e-4


class Level(NamedTuple):
    """One resolution of a picture; lengths are in pixels of the full picture.

    Fields
    ------
    grey : (h, w) grey levels.
    light : (h, w) the light that they stand for, on the same scale; `grey` itself where the
        camera's response is linear.
    quantum : step between two grey levels, 0 for real numbers.
    spacing_px : distance between two pixels of this level.
    kernel_variance_px2 : variance of the smoothing by the kernel at this level.
    sigma_strength : standard deviation of the gradient from noise, in grey levels per pixel.
    slope_variance : variance that noise gives the slope of the profile across a straight
        edge, averaged over one pixel of its length, in (grey levels per squared pixel)^2.
    """

    grey: Float[np.ndarray, "h w"]
    light: Float[np.ndarray, "h w"]
    quantum: float
    spacing_px: float
    kernel_variance_px2: float
    sigma_strength: float
    slope_variance: float


def fine_level(
    grey: Float[np.ndarray, "h w"],
    light: Float[np.ndarray, "h w"],
    quantum: float,
    kernel: GradientKernel,
) -> Level:
    """The picture itself."""
    return _level(grey, light, 1.0, quantum, kernel)


def half_level(fine: Level, kernel: GradientKernel) -> Level:
    """The picture with each two by two pixels averaged; an odd last row or column is left out."""
    half = _halved(fine.grey)
    light = half if fine.light is fine.grey else _halved(fine.light)
    return _level(half, light, 2.0, fine.quantum / 2, kernel)


def level_noise(grey: Float[np.ndarray, "h w"], quantum: float) -> float:
    """Standard deviation of the noise, not below that of the rounding to `quantum`.

    Real numbers, whose `quantum` is 0, have a ten-thousandth of their range for a floor.
    """
    noise = noise_sigma(grey, quantum=quantum, stride=(max(1, (len(grey) - 2) // _MOST_ROWS), 1))
    floor = _QUANTISATION_SIGMA * quantum if quantum else _LEAST_OF_RANGE * float(np.ptp(grey))
    return max(noise, floor, float(np.finfo(np.float32).tiny) ** 0.25)


def _halved(grey: Float[np.ndarray, "h w"]) -> np.ndarray:
    height, width = (side // 2 * 2 for side in grey.shape)
    return cv2.resize(
        grey[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )


def _level(
    grey: Float[np.ndarray, "h w"],
    light: Float[np.ndarray, "h w"],
    spacing: float,
    quantum: float,
    kernel: GradientKernel,
) -> Level:
    sigma = level_noise(grey, quantum)
    # Averaging pixels smooths by (spacing^2 - 1) / 12, as does any box.
    variance = kernel.variance_px2 * spacing**2 + (spacing**2 - 1) / 12
    return Level(
        grey,
        light,
        quantum,
        spacing,
        variance,
        sigma * kernel.noise_gain / spacing,
        sigma**2 * kernel.slope_gain / spacing**3,
    )
