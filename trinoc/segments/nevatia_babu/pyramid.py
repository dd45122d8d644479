"""The picture at full and at half resolution.

The fine level places edges well and parts neighbours; the coarse one averages four pixels
into one and so sees edges of half the contrast. It serves where the fine level sees nothing.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.image import Light, level_noise
from trinoc.segments.nevatia_babu.masks import GradientKernel

# Rows enough for a noise good to one part in a hundred; more would only cost time.
_MOST_ROWS = 60


class Level(NamedTuple):
    """One resolution of a picture; lengths are in pixels of the full picture.

    Fields
    ------
    picture : levels and light.
    spacing_px : distance between two pixels of this level.
    kernel_variance_px2 : variance of the smoothing by the kernel at this level.
    sigma_strength : standard deviation of the gradient from noise, in grey levels per pixel.
    slope_variance : variance that noise gives the slope of the profile across a straight
        edge, averaged over one pixel of its length, in (grey levels per squared pixel)^2.
    """

    picture: Light
    spacing_px: float
    kernel_variance_px2: float
    sigma_strength: float
    slope_variance: float


def fine_level(picture: Light, kernel: GradientKernel) -> Level:
    """The picture itself."""
    return _level(picture, 1.0, kernel)


def half_level(fine: Level, kernel: GradientKernel) -> Level:
    """The picture with each two by two pixels averaged; an odd last row or column is left out."""
    picture = fine.picture
    levels = _halved(picture.levels)
    light = levels if picture.is_linear else _halved(picture.light)
    half = picture._replace(levels=levels, light=light, quantum=picture.quantum / 2)
    return _level(half, 2.0, kernel)


def _halved(grey: Float[np.ndarray, "h w"]) -> np.ndarray:
    height, width = (side // 2 * 2 for side in grey.shape)
    return cv2.resize(
        grey[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )


def _level(picture: Light, spacing: float, kernel: GradientKernel) -> Level:
    rows = max(1, (len(picture.levels) - 2) // _MOST_ROWS)
    sigma = level_noise(picture.levels, picture.quantum, (rows, 1))
    # Averaging pixels smooths by (spacing^2 - 1) / 12, as does any box.
    variance = kernel.variance_px2 * spacing**2 + (spacing**2 - 1) / 12
    return Level(
        picture,
        spacing,
        variance,
        sigma * kernel.noise_gain / spacing,
        sigma**2 * kernel.slope_gain / spacing**3,
    )
