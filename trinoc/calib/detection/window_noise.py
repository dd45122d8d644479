"""Covariance of positions that were fitted to windows of an image, from the residuals of the fits.

Image noise varies over a window, and neighbouring pixels share it: cameras remove noise,
interpolate a colour mosaic, compress. The covariance therefore allows for both, as in T. G. Conley,
"GMM estimation with cross sectional dependence", Journal of Econometrics 92 (1999). With r_i the
residual of pixel i and a_i the change of the position by it, the position has the variance

    S = sum over pixels i, j of k(j - i) r_i r_j a_i a_j^T,

where the kernel k is 1 for neighbours and 0 beyond a few pixels. A fit follows part of the noise,
so that S is too small. For independent noise of variance 1 its expectation E is known exactly. One
window holds too few pixels for a reliable S: the ratio S / E is therefore averaged over all windows
of the image, and multiplies the covariance that independent noise of variance 1 would give. Nothing
is iterated, so nothing can diverge.

The fitted shapes are symmetric about their position, and so is what the model lacks of blur,
response and saturation: this moves nothing. The noise is therefore estimated from the half of the
residuals that changes sign in the position, (r(x) - r(-x)) / sqrt(2), which has the noise's
variance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.calib.tuning.every_group import CalibTuning

# numerical: pixels of a pair that counts are at most so far apart in rows or columns.
_REACH = 2
# numerical: a window whose fit follows more of the noise than all but this share does not count.
_LEAST_FREE = 0.1
# numerical: in the mean, a window's ratio counts up to so many times the median; a window beyond
# that has a larger covariance of its own.
_LARGEST_RATIO = 4.0
_EMPTY = cv2.BORDER_CONSTANT  # nothing lies beyond a window


class WindowPixels(NamedTuple):
    """Pixels of n windows, at most k each.

    Fields
    ------
    side : side of the square windows, px.
    column, row : (n, k) position of each pixel from the window's first.
    used : (n, k) which of the k pixels exist.
    """

    side: int
    column: Int[np.ndarray, "n k"]
    row: Int[np.ndarray, "n k"]
    used: Bool[np.ndarray, "n k"]

    def lay_out(self, values: Shaped[np.ndarray, "n k *p"]) -> Shaped[np.ndarray, "n side side *p"]:
        """Values of pixels as images of the windows, 0 where no pixel is used."""
        tiles = np.zeros((len(values), self.side, self.side, *values.shape[2:]), values.dtype)
        window, pixel = np.nonzero(self.used)
        tiles[window, self.row[window, pixel], self.column[window, pixel]] = values[window, pixel]
        return tiles

    def opposite(
        self, positions: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, "n k"], Bool[np.ndarray, "n k"]]:
        """For each pixel the one across its window's position, and whether it is used.

        positions : column and row from the window's first pixel; rounded to half a pixel.
        """
        count = self.used.shape[1]
        number = self.lay_out(np.broadcast_to(np.arange(1, count + 1), self.used.shape))
        twice = np.rint(2.0 * positions).astype(int)
        column, row = twice[:, :1] - self.column, twice[:, 1:] - self.row
        inside = (column >= 0) & (column < self.side) & (row >= 0) & (row < self.side)
        window = np.arange(len(self.used))[:, None]
        column, row = (np.clip(each, 0, self.side - 1) for each in (column, row))
        index = number[window, row, column] - 1
        return np.maximum(index, 0), self.used & inside & (index >= 0)


def sandwich_covariance(
    pixels: WindowPixels,
    positions: Float[np.ndarray, "n 2"],
    residual: Float[np.ndarray, "n k"],
    jacobian: Float[np.ndarray, "n k p"],
    covariance: Float[np.ndarray, "n p p"],
    odd: Sequence[int],
    tuning: CalibTuning,
) -> Float[np.ndarray, "n 2 2"]:
    """Covariance of the position of each window, px^2 for residuals in grey levels.

    Parameters
    ----------
    pixels : the windows.
    positions : (n, 2) fitted column and row, from the window's first pixel.
    residual, jacobian : (n, k), (n, k, p) at the end of the fit.
    covariance : (n, p, p) of the parameters for independent noise of variance 1; positive definite.
    odd : parameters whose derivatives change sign in the position; the position's own two first.
    """
    odd = list(odd)
    across, has_opposite = pixels.opposite(positions)
    residual, jacobian = residual * pixels.used, jacobian * pixels.used[..., None]
    by_pixel = jacobian @ covariance[:, :, odd[:2]].astype(np.float32)
    white = (by_pixel.mT @ by_pixel).astype(float)
    by_pixel = has_opposite[..., None] * by_pixel
    opposed = (residual - _take(residual, across)) * np.float32(np.sqrt(0.5))
    moves = np.empty((*opposed.shape, 1 + len(odd), 2), np.float32)
    np.multiply(opposed[..., None], by_pixel, out=moves[:, :, 0])
    # The part of the jacobian that changes sign, in standard deviations of its parameters: of such
    # noise the fit follows twice the square of each column.
    root = np.linalg.cholesky(covariance[:, odd][:, :, odd]).astype(np.float32)
    followed = 0.5 * (jacobian[..., odd] - _take(jacobian[..., odd], across)) @ root
    np.multiply(followed[..., None], by_pixel[:, :, None], out=moves[:, :, 1:])
    (squares, observed), *by_column = _sum_pairs(pixels, moves)
    lost_squares, lost = 2.0 * np.sum(by_column, axis=0)
    influence = np.sum(by_pixel**2, axis=2, dtype=float)
    total = influence.sum(axis=1)
    # A pixel and the one across it have the same noise but for the sign.
    apart = 2.0 * (pixels.column - positions[:, :1]), 2.0 * (pixels.row - positions[:, 1:])
    twins = np.sum(influence * _weight(apart[0]) * _weight(apart[1]), axis=1)
    expected, expected_squares = total + twins - lost, total - lost_squares
    counts = (total > 0) & (np.minimum(expected, expected_squares) > _LEAST_FREE * total)
    if not counts.any():
        return white
    ratio = np.divide(observed, expected, out=np.zeros_like(total), where=counts)
    # Correlations make the sum of one window negative by chance, that of all windows seldom.
    least = tuning.photometric.least_spread * _mean(squares[counts] / expected_squares[counts])
    scale = max(_mean(ratio[counts]), least, 1e-300)
    return white * np.maximum(scale, ratio / _LARGEST_RATIO)[:, None, None]


def _sum_pairs(
    pixels: WindowPixels, moves: Float[np.ndarray, "n k m 2"]
) -> Float[np.ndarray, "m s n"]:
    """Sum of squares, and sum of products over pairs of near pixels, of m values of each pixel.

    moves : m changes of the position of each of n windows by each pixel.
    """
    count, sets = len(moves), moves.shape[2]
    # All windows are filtered as one image, with empty rows between them.
    padded = np.zeros((sets, count, pixels.side + _REACH, pixels.side, 2), moves.dtype)
    tiles = padded[:, :, : pixels.side]
    tiles[:] = np.moveaxis(pixels.lay_out(moves), 3, 0)
    kernel = _weight(np.arange(-_REACH, _REACH + 1.0)).astype(np.float32)
    column = padded.reshape(-1, pixels.side, 2)
    near = cv2.sepFilter2D(column, -1, kernel, kernel, borderType=_EMPTY).reshape(padded.shape)
    products = tiles**2, tiles * near[:, :, : pixels.side]
    return np.stack([np.sum(each, axis=(2, 3, 4), dtype=float) for each in products], axis=1)


def _weight(distance_px: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Weight of a pair of pixels by its distance in rows or columns: 1 for neighbours, then falling
    linearly to 0."""
    return np.clip(2.0 - 2.0 * np.abs(distance_px) / (_REACH + 1), 0.0, 1.0)


def _mean(ratio: Float[np.ndarray, "n"]) -> float:
    """Mean over windows, of which none counts with more than a few times the median."""
    limit = _LARGEST_RATIO * max(float(np.median(ratio)), 0.0)
    return float(np.mean(np.clip(ratio, -limit, limit)))


def _take(
    values: Shaped[np.ndarray, "n k *p"], index: Int[np.ndarray, "n k"]
) -> Shaped[np.ndarray, "n k *p"]:
    """Values of one pixel of the same window for each pixel."""
    return values[np.arange(len(values))[:, None], index]
