"""Any picture as grey levels, the same for calibration, segments and users.

The grey level of a colour pixel is the mean of its red, green and blue. So it does not matter
whether a reader delivers RGB (imageio, Pillow, matplotlib) or BGR (OpenCV), and the noise is the
least that three channels of equal noise allow.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.errors import InputError

SMALLEST_SIDE_PX = 16


class GreyImage(NamedTuple):
    """A grey picture.

    Fields
    ------
    grey : (h, w) grey levels, on the scale of the picture's own numbers.
    quantum : step between two levels, 0 for real numbers.
    white : the largest level that can be told from a larger one; infinite where not known.
    """

    grey: Float[np.ndarray, "h w"]
    quantum: float
    white: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.grey.shape[1], self.grey.shape[0]


def grey_image(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """Grey levels of an (h, w) or (h, w, channels) picture of whole or real numbers.

    One channel is grey, two are grey and alpha, three are colours in either order, four are
    colours and alpha. Raises InputError for what is no picture: other shapes and types, pictures
    under 16 pixels a side, values that are not finite.
    """
    array = np.asarray(image)
    if array.dtype.kind not in "buif":
        raise InputError(
            f"A picture of {array.dtype} holds no grey levels: give an array of numbers."
        )
    channels = array.shape[2] if array.ndim == 3 else 1
    if array.ndim not in (2, 3) or not 1 <= channels <= 4:
        raise InputError(
            f"The picture has shape {array.shape}, but must be (height, width) or "
            "(height, width, 3)."
        )
    if min(array.shape[:2]) < SMALLEST_SIDE_PX:
        raise InputError(
            f"The picture is {array.shape[1]} x {array.shape[0]} px, but must have at least "
            f"{SMALLEST_SIDE_PX} px a side."
        )
    whole = array.dtype.kind != "f"
    quantum, white = (1.0, _white(array.dtype)) if whole else (0.0, np.inf)
    planes = [array] if array.ndim == 2 else list(np.moveaxis(array, 2, 0))
    if channels < 3:
        grey = np.ascontiguousarray(planes[0], dtype=np.float32)
    else:
        red, green, blue = (plane.astype(np.float32) for plane in planes[:3])
        # In this order the sum is the same, to the last bit, with red and blue exchanged.
        grey = (green + (red + blue)) / np.float32(3)
        if whole and not (np.array_equal(red, green) and np.array_equal(green, blue)):
            quantum /= 3
    if not np.isfinite(grey.sum(dtype=np.float64)):
        raise InputError("The picture has values that are not finite: replace them first.")
    return GreyImage(grey, quantum, white)


def _white(dtype: np.dtype) -> float:
    """The last level below saturation, in 255ths as cameras that shift their bits deliver it."""
    if dtype not in (np.uint8, np.uint16):
        return np.inf
    return 254 / 255 * np.iinfo(dtype).max
