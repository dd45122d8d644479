"""The noise of a picture, from the picture itself.

The product of the second differences along u and v is zero on ramps and on straight edges along
either axis. The median of its size is not moved by the few corners, oblique edges and texture that
are left (J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding
64(2), 1996, doi 10.1006/cviu.1996.0060, with a median in place of its mean).
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics.tails import MAD_TO_SIGMA

# Root of the sum of squares of the mask: what independent noise is multiplied by.
_GAIN = 6.0
_FEWEST_PIXELS = 50
_ROUNDING_SIGMA = float(np.sqrt(1 / 12))
# Pictures of real numbers are taken to be good to this share of their range.
_LEAST_OF_RANGE = 1e-4


def noise_sigma(
    grey: Float[np.ndarray, "h w"],
    *,
    quantum: float | None = None,
    stride: tuple[int, int] = (1, 1),
    flat: Bool[np.ndarray, "h w"] | None = None,
) -> float:
    """Standard deviation of the noise in grey levels, rounding included.

    quantum : step between two grey levels, over which equal answers are spread. With 0, for real
        numbers, the answer is a plain median. By default 1 where all levels are whole, 0 otherwise.
    stride : look at every so many rows and columns only.
    flat : pixels to look at, if all eight neighbours are flat too. Fewer than 50 give NaN.
    """
    rows, columns = stride
    down = grey[:-2:rows] + grey[2::rows] - 2 * grey[1:-1:rows]
    size = np.abs(down[:, :-2:columns] + down[:, 2::columns] - 2 * down[:, 1:-1:columns]) / _GAIN
    if flat is None:
        size = size.ravel()
    else:
        inside = cv2.erode(flat.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        size = size[inside[1:-1:rows, 1:-1:columns]]
        if len(size) < _FEWEST_PIXELS:
            return float("nan")
    if quantum is None:
        quantum = float(np.array_equal(grey, np.rint(grey)))
    return float(MAD_TO_SIGMA * _median(size, quantum / _GAIN))


def level_noise(
    grey: Float[np.ndarray, "h w"], quantum: float, stride: tuple[int, int] = (1, 1)
) -> float:
    """`noise_sigma` of a picture, not below that of the rounding to `quantum`, and never 0.

    Real numbers, whose `quantum` is 0, have a ten-thousandth of their range for a floor.
    """
    noise = noise_sigma(grey, quantum=quantum, stride=stride)
    floor = _ROUNDING_SIGMA * quantum if quantum else _LEAST_OF_RANGE * float(np.ptp(grey))
    return max(noise, floor, float(np.finfo(np.float32).tiny) ** 0.25)


def _median(values: Float[np.ndarray, "n"], step: float) -> float:
    """The median of values that rounding has thrown together, each spread over its step."""
    middle = len(values) // 2
    median = float(np.partition(values, middle)[middle])
    if not step:
        return median
    # Where inside its step the median lies, the counts of smaller and of equal values tell.
    below, equal = np.count_nonzero(values < median), np.count_nonzero(values == median)
    return max(0.0, median + step * ((middle + 0.5 - below) / equal - 0.5))
