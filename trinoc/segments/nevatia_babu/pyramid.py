"""The picture at full and at half resolution.

The fine level places edges well and parts neighbours; the coarse one averages four pixels
into one and so sees edges of half the contrast. It serves where the fine level sees nothing.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.segments.nevatia_babu.masks import GradientKernel
from trinoc.segments.nevatia_babu.noise import noise_sigma


class Level(NamedTuple):
    """One resolution of a picture; lengths are in pixels of the full picture.

    Fields
    ------
    grey : (h, w) grey levels.
    quantum : step between two grey levels, 0 for real numbers.
    spacing_px : distance between two pixels of this level.
    kernel_variance_px2 : variance of the smoothing by the kernel at this level.
    sigma_strength : standard deviation of the gradient from noise, in grey levels per pixel.
    slope_variance : variance that noise gives the slope of the profile across a straight
        edge, averaged over one pixel of its length, in (grey levels per squared pixel)^2.
    """

    grey: Float[np.ndarray, "h w"]
    quantum: float
    spacing_px: float
    kernel_variance_px2: float
    sigma_strength: float
    slope_variance: float


def fine_level(grey: Float[np.ndarray, "h w"], quantum: float, kernel: GradientKernel) -> Level:
    """The picture itself."""
    return _level(grey, 1.0, quantum, kernel)


def half_level(fine: Level, kernel: GradientKernel) -> Level:
    """The picture with each two by two pixels averaged; an odd last row or column is left out."""
    height, width = (side // 2 * 2 for side in fine.grey.shape)
    half = cv2.resize(
        fine.grey[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )
    return _level(half, 2.0, fine.quantum / 2, kernel)


def _level(
    grey: Float[np.ndarray, "h w"], spacing: float, quantum: float, kernel: GradientKernel
) -> Level:
    sigma = noise_sigma(grey, quantum)
    # Averaging pixels smooths by (spacing^2 - 1) / 12, as does any box.
    variance = kernel.variance_px2 * spacing**2 + (spacing**2 - 1) / 12
    return Level(
        grey,
        quantum,
        spacing,
        variance,
        sigma * kernel.noise_gain / spacing,
        sigma**2 * kernel.slope_gain / spacing**3,
    )
