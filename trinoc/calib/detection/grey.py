"""A picture as every later step wants it: grey, 32-bit, with its noise known."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.errors import InputError
from trinoc.numerics import MAD_TO_SIGMA

_NOISE_SAMPLES = 20_000
_SMALLEST_SIDE_PX = 16


class GreyImage(NamedTuple):
    """A grey picture and the standard deviation of its noise, in its own grey levels."""

    grey: Float[np.ndarray, "h w"]
    noise_sigma: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.grey.shape[1], self.grey.shape[0]


def grey_image(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """`image` in grey: 8 or 16 bit or real numbers; one, three or four (with alpha) channels.

    The channels are averaged, whatever their order; grey levels keep their scale.

    Raises
    ------
    InputError : it is no picture: wrong shape, too small, or with values that are not finite.
    """
    array = np.asarray(image)
    if array.dtype == object or array.dtype.kind not in "buif":
        raise InputError(
            f"A picture of {array.dtype} holds no grey levels; give an array of numbers."
        )
    if array.ndim == 3 and array.shape[2] in (1, 2, 3, 4):
        colours = 3 if array.shape[2] >= 3 else 1
        array = array[..., :colours].mean(axis=2, dtype=np.float32)
    if array.ndim != 2 or min(array.shape) < _SMALLEST_SIDE_PX:
        raise InputError(
            f"A picture of shape {np.shape(image)} cannot show a sheet; give (height, width)"
            f" or (height, width, 3), each side at least {_SMALLEST_SIDE_PX} pixels."
        )
    grey = np.ascontiguousarray(array, dtype=np.float32)
    if not np.isfinite(cv2.sumElems(grey)[0]):
        raise InputError("The picture holds values that are not finite; replace them first.")
    return GreyImage(grey, _noise_sigma(grey))


def reduced(picture: GreyImage, factor: int) -> GreyImage:
    """The picture in pixels `factor` times as wide, each the mean of those that it covers."""
    if factor == 1:
        return picture
    width, height = (side // factor for side in picture.size_px)
    grey = cv2.resize(
        picture.grey[: height * factor, : width * factor],
        (width, height),
        interpolation=cv2.INTER_AREA,
    )
    return GreyImage(grey, picture.noise_sigma / factor)


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
