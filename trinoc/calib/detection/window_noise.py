"""Covariance of positions fitted to image windows, for correlated noise of varying strength.

Image noise varies over a window, and neighbouring pixels have correlated noise: cameras filter
noise, interpolate a colour mosaic and compress. The covariance is therefore estimated from the
residuals. With r_i the residual of pixel i and a_i the derivative of the position by its grey
level, it is

    S = sum over pixels i, j of k(j - i) r_i r_j a_i a_j^T,

where the kernel k is 1 for neighbours and 0 beyond a few pixels. A fit follows part of the noise,
so that S is too small. For independent noise of variance 1, the expectation E of S is known
exactly. One window has too few pixels for a reliable S. The mean of S / E over all windows of the
image multiplies the covariance for independent noise of variance 1. The computation is direct,
without iterations that could diverge.

The fitted shapes are symmetric about their position. Errors of the model of blur, response and
saturation are symmetric as well and do not move the position. The noise is therefore estimated from
the odd part of the residuals about the position, (r(x) - r(-x)) / sqrt(2). It has the variance of
the noise.

References
----------
T. G. Conley, "GMM estimation with cross sectional dependence", Journal of Econometrics 92, 1999.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.calib.tuning.every_group import CalibTuning

# numerical: largest distance of correlated pixels in rows and in columns.
_REACH = 2
# numerical: smallest share of the noise that a fit must not follow; other windows are excluded.
_LEAST_FREE = 0.1
# numerical: limit of a window's ratio in the mean, over the median. The covariance of a window
# beyond it is enlarged individually.
_LARGEST_RATIO = 4.0
_EMPTY = cv2.BORDER_CONSTANT  # zeros beyond the image


class WindowPixels(NamedTuple):
    """Pixels of n square image windows, at most k pixels per window.

    Attributes
    ----------
    side : side of the windows, px.
    column, row : (n, k) position of each pixel relative to the first pixel of its window.
    used : (n, k) mask of the valid entries.
    """

    side: int
    column: Int[np.ndarray, "n k"]
    row: Int[np.ndarray, "n k"]
    used: Bool[np.ndarray, "n k"]

    def as_tiles(
        self, values: Shaped[np.ndarray, "n k *p"]
    ) -> Shaped[np.ndarray, "n side side *p"]:
        """Arrange values of pixels as one small image per window, with 0 for unused pixels."""
        tiles = np.zeros((len(values), self.side, self.side, *values.shape[2:]), values.dtype)
        window, pixel = np.nonzero(self.used)
        tiles[window, self.row[window, pixel], self.column[window, pixel]] = values[window, pixel]
        return tiles

    def opposite(
        self, positions: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, "n k"], Bool[np.ndarray, "n k"]]:
        """Index of the pixel opposite to each pixel, mirrored at a position in the window.

        Parameters
        ----------
        positions : (n, 2) column and row relative to the window's first pixel; rounded to half a
            pixel.

        Returns
        -------
        (n, k) index of the opposite pixel in its window, and (n, k) mask of the pixels that have
        one.
        """
        count = self.used.shape[1]
        number = self.as_tiles(np.broadcast_to(np.arange(1, count + 1), self.used.shape))
        doubled = np.rint(2.0 * positions).astype(int)
        column, row = doubled[:, :1] - self.column, doubled[:, 1:] - self.row
        inside = (column >= 0) & (column < self.side) & (row >= 0) & (row < self.side)
        window = np.arange(len(self.used))[:, None]
        column, row = (np.clip(axis, 0, self.side - 1) for axis in (column, row))
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
    """Covariance of the fitted position in each window, px^2, for correlated pixel noise.

    The strength of the noise may vary over the image. The docstring of the module derives the
    estimate.

    Parameters
    ----------
    pixels : pixels of the windows.
    positions : (n, 2) fitted column and row relative to the window's first pixel.
    residual, jacobian : (n, k), (n, k, p) residuals at the end of the fit, and their derivatives
        with respect to the parameters.
    covariance : (n, p, p) positive definite covariance of the parameters for independent noise of
        variance 1.
    odd : indices of the parameters whose derivatives change sign if the window is mirrored at the
        position. The first two parameters are the position.
    tuning : tuned constants of calibration.

    Returns
    -------
    (n, 2, 2) covariances.
    """
    odd = list(odd)
    opposite_index, has_opposite = pixels.opposite(positions)
    residual, jacobian = residual * pixels.used, jacobian * pixels.used[..., None]
    by_pixel = jacobian @ covariance[:, :, odd[:2]].astype(np.float32)
    white = (by_pixel.mT @ by_pixel).astype(float)
    by_pixel = has_opposite[..., None] * by_pixel
    odd_residual = (residual - _take(residual, opposite_index)) * np.float32(np.sqrt(0.5))
    moves = np.empty((*odd_residual.shape, 1 + len(odd), 2), np.float32)
    np.multiply(odd_residual[..., None], by_pixel, out=moves[:, :, 0])
    # Odd part of the Jacobian, in standard deviations of its parameters. The fit removes twice the
    # square of each column from the odd noise.
    root = np.linalg.cholesky(covariance[:, odd][:, :, odd]).astype(np.float32)
    odd_jacobian = 0.5 * (jacobian[..., odd] - _take(jacobian[..., odd], opposite_index)) @ root
    np.multiply(odd_jacobian[..., None], by_pixel[:, :, None], out=moves[:, :, 1:])
    (squares, observed), *by_column = _sum_pairs(pixels, moves)
    absorbed_squares, absorbed = 2.0 * np.sum(by_column, axis=0)
    influence = np.sum(by_pixel**2, axis=2, dtype=float)
    total = influence.sum(axis=1)
    # The odd noise of a pixel and of the opposite one are equal except for the sign.
    separation = 2.0 * (pixels.column - positions[:, :1]), 2.0 * (pixels.row - positions[:, 1:])
    pairs = np.sum(influence * _weight(separation[0]) * _weight(separation[1]), axis=1)
    expected, expected_squares = total + pairs - absorbed, total - absorbed_squares
    is_valid = (total > 0) & (np.minimum(expected, expected_squares) > _LEAST_FREE * total)
    if not is_valid.any():
        return white
    ratio = np.divide(observed, expected, out=np.zeros_like(total), where=is_valid)
    # By chance the sum of one window can be negative, that of all windows only rarely.
    mean_square = _mean(squares[is_valid] / expected_squares[is_valid])
    smallest = tuning.photometric.least_spread * mean_square
    scale = max(_mean(ratio[is_valid]), smallest, 1e-300)
    return white * np.maximum(scale, ratio / _LARGEST_RATIO)[:, None, None]


def _sum_pairs(
    pixels: WindowPixels, moves: Float[np.ndarray, "n k m 2"]
) -> Float[np.ndarray, "m s n"]:
    """Sums over the pixels and over the pairs of neighbouring pixels of each window.

    Parameters
    ----------
    moves : (n, k, m, 2) m sets of changes (x, y) of the fitted position of each window. Each of
        its k pixels causes one change.

    Returns
    -------
    (m, 2, n) for each set and window: sum of the squared changes, and sum of the products of the
    changes of two neighbouring pixels, weighted by `_weight`.
    """
    count, sets = len(moves), moves.shape[2]
    # All windows are filtered as one image, with empty rows between them.
    padded = np.zeros((sets, count, pixels.side + _REACH, pixels.side, 2), moves.dtype)
    tiles = padded[:, :, : pixels.side]
    tiles[:] = np.moveaxis(pixels.as_tiles(moves), 3, 0)
    kernel = _weight(np.arange(-_REACH, _REACH + 1.0)).astype(np.float32)
    column = padded.reshape(-1, pixels.side, 2)
    filtered = cv2.sepFilter2D(column, -1, kernel, kernel, borderType=_EMPTY)
    neighbours = filtered.reshape(padded.shape)[:, :, : pixels.side]
    products = tiles**2, tiles * neighbours
    return np.stack([np.sum(product, axis=(2, 3, 4), dtype=float) for product in products], axis=1)


def _weight(distance_px: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Weight of a pair of pixels as a function of their distance along rows or along columns.

    The weight is 1 up to a distance of about one pixel and decreases linearly to 0.
    """
    return np.clip(2.0 - 2.0 * np.abs(distance_px) / (_REACH + 1), 0.0, 1.0)


def _mean(ratio: Float[np.ndarray, "n"]) -> float:
    """Mean of a ratio over the windows; values beyond a multiple of the median are clipped."""
    limit = _LARGEST_RATIO * max(float(np.median(ratio)), 0.0)
    return float(np.mean(np.clip(ratio, -limit, limit)))


def _take(
    values: Shaped[np.ndarray, "n k *p"], index: Int[np.ndarray, "n k"]
) -> Shaped[np.ndarray, "n k *p"]:
    """For each pixel, values of another pixel of the same window.

    index : (n, k) index of the other pixel.
    """
    return values[np.arange(len(values))[:, None], index]
