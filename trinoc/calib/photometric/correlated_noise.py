"""Noise that neighbouring pixels share, as mosaics, JPEG, denoising and resampling make it."""

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Bool, Float, Int

_REACH_PX = 4
# A correlation below this many of its standard deviations counts as none.
_SIGNIFICANT = 3.0


class OnGrid:
    """Scattered pixels as a small picture, and back."""

    def __init__(self, column: Int[np.ndarray, "n"], row: Int[np.ndarray, "n"]) -> None:
        self.place = (row - row.min(), column - column.min())
        self.shape = (int(self.place[0].max()) + 1, int(self.place[1].max()) + 1)

    def picture(self, values: Float[np.ndarray, "n"]) -> Float[np.ndarray, "h w"]:
        """The values at their pixels, 0 elsewhere."""
        field = np.zeros(self.shape)
        field[self.place] = values
        return field


def autocorrelation(
    grid: OnGrid, residual: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "9 9"]:
    """Correlation of residuals by the distance of their pixels, lag 0 in the middle.

    What cannot be told from none is 0: the sum over all lags would else be noise.
    """
    sums, counts = (_products(grid.picture(values * kept)) for values in (residual, kept * 1.0))
    counts = np.maximum(np.round(counts), 1.0)
    middle = _REACH_PX
    variance = max(sums[middle, middle] / counts[middle, middle], 1e-12)
    correlation = sums / counts / variance
    correlation[np.abs(correlation) < _SIGNIFICANT / np.sqrt(counts)] = 0.0
    correlation[middle, middle] = 1.0
    return correlation


def inflation(correlation: Float[np.ndarray, "9 9"]) -> float:
    """By how much the variance of a mean of neighbours is larger than without correlation."""
    return max(float(correlation.sum()), 1.0)


def correlated_sum(
    grid: OnGrid, rows: Float[np.ndarray, "p n"], correlation: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, "p p"]:
    """Sum over all pairs of pixels of row_i correlation_ij row_j^T.

    The middle of a sandwich covariance, for rows over the noise's standard deviation.
    """
    pictures = [grid.picture(row) for row in rows]
    spread = [
        cv2.filter2D(picture, -1, correlation, borderType=cv2.BORDER_CONSTANT)
        for picture in pictures
    ]
    total = np.array([[np.sum(one * other) for other in spread] for one in pictures])
    return 0.5 * (total + total.T)


def _products(field: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "9 9"]:
    """Sums of products of pixels at each lag."""
    height, width = (scipy.fft.next_fast_len(size + _REACH_PX, real=True) for size in field.shape)
    power = np.abs(np.asarray(scipy.fft.rfft2(field, (height, width)))) ** 2
    lags = np.arange(-_REACH_PX, _REACH_PX + 1)
    products = np.asarray(scipy.fft.irfft2(power, (height, width)))
    return products[np.ix_(lags, lags)]
