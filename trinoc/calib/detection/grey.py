"""A picture as the search wants it: grey, with its noise known."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.numerics import MAD_TO_SIGMA, grey_image

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
    return SearchImage(grey, _noise_sigma(grey))


def reduced(image: SearchImage, factor: int) -> SearchImage:
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


def _noise_sigma(grey: Float[np.ndarray, "h w"]) -> float:
    """Median absolute second difference (Immerkaer 1996, doi 10.1006/cviu.1996.0060)."""
    step = max(1, round(np.sqrt(grey.size / _NOISE_SAMPLES)))
    above, middle, below = (grey[first : grey.shape[0] - 2 + first : step] for first in range(3))
    # Second difference along both axes: blind to planes of light; the squares sum to 36.
    down = above + below
    down -= 2.0 * middle
    second = down[:, :-2:step] - 2.0 * down[:, 1:-1:step] + down[:, 2::step]
    sample = np.abs(second).ravel() / 6.0
    median = float(np.partition(sample, len(sample) // 2)[len(sample) // 2])
    return MAD_TO_SIGMA * median
