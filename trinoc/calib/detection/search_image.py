"""A picture as the search wants it: grey, with its noise known."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image.grey import grey_image
from trinoc.image.noise import noise_sigma

# numerical: size of a sample.
_NOISE_SAMPLES = 20_000


class SearchImage(NamedTuple):
    """A grey picture and the standard deviation of its noise, in its own grey levels."""

    grey: Float[np.ndarray, "h w"]
    noise_sigma: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.grey.shape[1], self.grey.shape[0]


def search_image(image: Shaped[np.ndarray, "..."]) -> SearchImage:
    """`image` in grey, with its noise. Raises InputError for what is no picture."""
    grey = grey_image(image).grey
    step = max(1, round(np.sqrt(grey.size / _NOISE_SAMPLES)))
    # The thresholds were chosen with the plain median, in steps of a quarter of a whole level.
    return SearchImage(grey, noise_sigma(grey, quantum=0.0, stride=(step, step)))


def shrink_image(image: SearchImage, factor: int) -> SearchImage:
    """The picture in pixels `factor` times as wide, each the mean of those that it covers."""
    if factor == 1:
        return image
    width, height = (side // factor for side in image.size_px)
    grey = cv2.resize(
        image.grey[: height * factor, : width * factor],
        (width, height),
        interpolation=cv2.INTER_AREA,
    )
    return SearchImage(grey, image.noise_sigma / factor)
