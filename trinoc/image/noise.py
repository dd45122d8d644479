"""Noise of an image, estimated from the image itself.

The product of the second differences along u and v is zero on ramps and on straight edges along
either axis. Corners, oblique edges and texture remain; they are few and do not affect the median.
Source: J. Immerkaer, "Fast noise variance estimation", Computer Vision and Image Understanding
64(2), 1996, doi 10.1006/cviu.1996.0060, with a median in place of the mean.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.numerics.tails import MAD_TO_SIGMA

# Norm of the mask, the factor of independent noise.
_GAIN = 6.0
_FEWEST_PIXELS = 50
_ROUNDING_SIGMA = float(np.sqrt(1 / 12))
# Smallest noise of images of real numbers, as a share of their range.
_LEAST_OF_RANGE = 1e-4


def noise_sigma(
    grey: Float[np.ndarray, "h w"],
    *,
    quantum: float | None = None,
    stride: tuple[int, int] = (1, 1),
    flat: Bool[np.ndarray, "h w"] | None = None,
) -> float:
    """Estimate the standard deviation of the noise, in grey levels.

    The noise of rounding is included.

    Parameters
    ----------
    grey : (h, w)
        Grey levels.
    quantum : float, optional
        Step between two grey levels, for which the estimate is corrected. 0: no correction, for
        real numbers. Default: 1 if all levels are integers, else 0.
    stride : (int, int)
        Only every n-th row and every m-th column are used.
    flat : (h, w) bool, optional
        Mask of the pixels to use. A pixel is used if its eight neighbours are also in the mask.

    Returns
    -------
    float
        NaN if fewer than 50 pixels can be used.
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
    """Standard deviation of the noise, in grey levels, with a positive lower bound.

    The bound is the noise of rounding. For real numbers (`quantum` 0), it is 1e-4 of their range.

    Parameters
    ----------
    grey, quantum, stride :
        As in `noise_sigma`.
    """
    noise = noise_sigma(grey, quantum=quantum, stride=stride)
    floor = _ROUNDING_SIGMA * quantum if quantum else _LEAST_OF_RANGE * float(np.ptp(grey))
    return max(noise, floor, float(np.finfo(np.float32).tiny) ** 0.25)


def _median(values: Float[np.ndarray, "n"], step: float) -> float:
    """Median of rounded values, each assumed to be uniform over its rounding step."""
    middle = len(values) // 2
    median = float(np.partition(values, middle)[middle])
    if not step:
        return median
    # The counts of smaller and equal values give the position of the median inside its step.
    below, equal = np.count_nonzero(values < median), np.count_nonzero(values == median)
    return max(0.0, median + step * ((middle + 0.5 - below) / equal - 0.5))
