"""The noise of a picture, read off its flat parts without any model of what they show."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics import MAD_TO_SIGMA

_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
_GAIN = float(np.sqrt(np.sum(_MASK**2)))
_FEWEST_PIXELS = 50


def noise_floor(image: Float[np.ndarray, "h w"], flat: Bool[np.ndarray, "h w"]) -> float:
    """Standard deviation of the grey levels' noise, rounding included; NaN if nothing is flat.

    The median of the absolute response, on the `flat` pixels, to a mask that is blind to
    planes (J. Immerkaer, "Fast noise variance estimation", CVIU 64(2), 1996). What lies on the
    sheet, or is not flat after all, moves a median little.
    """
    apart = cv2.erode(flat.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if int(apart.sum()) < _FEWEST_PIXELS:
        return float("nan")
    response = cv2.filter2D(image.astype(np.float32), cv2.CV_32F, _MASK)
    return float(MAD_TO_SIGMA * _median_of_steps(np.abs(response[apart])) / _GAIN)


def _median_of_steps(values: Float[np.ndarray, "n"]) -> float:
    """The median of values that rounding has thrown together, each spread over its step.

    Whole grey levels give whole responses: a plain median moves in steps of a sixth of a level.
    """
    middle = np.partition(values, len(values) // 2)[len(values) // 2]
    below, above = values[values < middle], values[values > middle]
    if not len(above):
        return float(middle)
    low = 0.5 * (middle + (below.max() if len(below) else -middle))
    share = (0.5 * len(values) - len(below)) / (len(values) - len(below) - len(above))
    return float(low + share * (0.5 * (middle + above.min()) - low))
