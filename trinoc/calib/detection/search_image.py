"""First step of every detection: the grey image with an estimate of its noise."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image.grey import grey_image
from trinoc.image.noise import noise_sigma

# numerical: number of pixels from which the noise is estimated.
_NOISE_SAMPLES = 20_000


class SearchImage(NamedTuple):
    """Grey image with its noise.

    Attributes
    ----------
    grey : (h, w) grey levels.
    noise_sigma : standard deviation of the noise, grey levels.
    """

    grey: Float[np.ndarray, "h w"]
    noise_sigma: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Image size (width, height)."""
        return self.grey.shape[1], self.grey.shape[0]


def search_image(image: Shaped[np.ndarray, "..."]) -> SearchImage:
    """Convert an image to grey levels and estimate its noise.

    Parameters
    ----------
    image : grey or colour image.

    Raises
    ------
    InputError : `image` is no image.
    """
    grey = grey_image(image).grey
    step = max(1, round(np.sqrt(grey.size / _NOISE_SAMPLES)))
    # The thresholds were chosen with the noise by the plain median, without correction for
    # rounding to whole levels.
    return SearchImage(grey, noise_sigma(grey, quantum=0.0, stride=(step, step)))


def shrink_image(image: SearchImage, factor: int) -> SearchImage:
    """Reduce an image by `factor`; each new pixel is the mean of factor x factor pixels."""
    if factor == 1:
        return image
    width, height = (side // factor for side in image.size_px)
    grey = cv2.resize(
        image.grey[: height * factor, : width * factor],
        (width, height),
        interpolation=cv2.INTER_AREA,
    )
    return SearchImage(grey, image.noise_sigma / factor)
