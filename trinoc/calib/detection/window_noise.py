"""How far noise moves what is fitted to windows of a picture, by the residuals that are left.

Noise varies over a window, with the light and where the model is wrong, and neighbours share it:
cameras remove noise, interpolate a mosaic, compress. The covariance is then a sandwich (H. White,
"A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48(4), 1980), its middle
from the residuals' variance as it changes over a window, and from their correlation in all.

What is fitted is symmetric about its place but for what moves it, and so is what the model has not
of blur, response and saturation: that moves nothing. The noise is therefore read off the half of
the residuals that changes sign in the place, (r(x) - r(-x)) / sqrt(2), which has its variance.

A fit follows noise, and smooth noise most: what residuals lack of it is H R + R H - H R H for noise
of correlation R, where H projects on what is fitted. It is given back.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.calib.tuning.every_group import TUNING

# numerical: a residual says so little of itself where the fit follows it.
_LEAST_FREE = 0.1
# numerical: rounds in which the correlation is found, and as many pixels as tell it.
_ROUNDS, _ENOUGH_PIXELS = 5, 4500
_SETTLED = 0.3  # numerical: a change by so much of what can be told from none
_EMPTY = cv2.BORDER_CONSTANT  # nothing lies beyond a window


class WindowPixels(NamedTuple):
    """Pixels of windows, k each at most.

    Fields
    ------
    side : of the windows, in pixels.
    column, row : (n, k) of each from the window's first.
    used : (n, k) which there are.
    """

    side: int
    column: Int[np.ndarray, "n k"]
    row: Int[np.ndarray, "n k"]
    used: Bool[np.ndarray, "n k"]

    def take(self, index: slice) -> "WindowPixels":
        """Those of some windows."""
        return WindowPixels(self.side, self.column[index], self.row[index], self.used[index])

    def lay_out(self, values: Shaped[np.ndarray, "n k *p"]) -> Shaped[np.ndarray, "n side side *p"]:
        """What belongs to pixels, as they lie; 0 where there is none."""
        tiles = np.zeros((len(values), self.side, self.side, *values.shape[2:]), values.dtype)
        window, pixel = np.nonzero(self.used)
        at = window, self.row[window, pixel], self.column[window, pixel]
        tiles[at] = values[window, pixel]
        return tiles

    def neighbours(self, reach: int) -> Int[np.ndarray, "l n k"]:
        """The pixels so far to each side of each pixel, row by row, counted over all windows as if
        each had one more, which stands for none."""
        count = self.used.shape[1]
        number = self.lay_out(np.broadcast_to(np.arange(count) - count, self.used.shape)) + count
        number = np.pad(number, ((0, 0), (reach, reach), (reach, reach)), constant_values=count)
        window, lags = np.arange(len(self.used))[:, None], np.arange(2 * reach + 1)
        across = self.column + lags[:, None, None]
        number += window[:, None] * (count + 1)
        return number[window, (self.row + lags[:, None, None])[:, None], across].reshape(
            -1, *self.used.shape
        )

    def opposite(
        self, places: Float[np.ndarray, "n 2"]
    ) -> tuple[Int[np.ndarray, "n k"], Bool[np.ndarray, "n k"]]:
        """The pixel of each window that lies across its place, and whether there is one.

        places : column and row from the window's first pixel. To the nearest half of a pixel.
        """
        count = self.used.shape[1]
        number = self.lay_out(np.broadcast_to(np.arange(1, count + 1), self.used.shape))
        twice = np.rint(2.0 * places).astype(int)
        column, row = twice[:, :1] - self.column, twice[:, 1:] - self.row
        inside = (column >= 0) & (column < self.side) & (row >= 0) & (row < self.side)
        window = np.arange(len(self.used))[:, None]
        column, row = (np.clip(each, 0, self.side - 1) for each in (column, row))
        index = number[window, row, column] - 1
        return np.maximum(index, 0), self.used & inside & (index >= 0)


def sandwich_covariance(
    pixels: WindowPixels,
    places: Float[np.ndarray, "n 2"],
    residual: Float[np.ndarray, "n k"],
    rows: Float[np.ndarray, "n k p"],
    looks: Float[np.ndarray, "n k f"],
    covariance: Float[np.ndarray, "n p p"],
    odd: Sequence[int],
) -> Float[np.ndarray, "n 2 2"]:
    """Covariance of the place of each window.

    places : column and row from the window's first pixel.
    residual, rows : at the end of a fit, and its derivatives by the parameters.
    looks : functions over the window that the noise's variance is a sum of.
    covariance : of the parameters, were the noise independent and of unit variance.
    odd : parameters whose derivatives change sign in the place, its own two first.
    """
    place, odd = list(odd[:2]), list(odd)
    across, has = pixels.opposite(places)
    residual, rows = residual * pixels.used, rows * pixels.used[..., None]
    seen = has.astype(np.float32)
    root = 0.5 * np.linalg.cholesky(covariance[:, odd][:, :, odd]).astype(np.float32)
    followed = seen[..., None] * (rows[..., odd] - _take(rows[..., odd], across)) @ root
    free = np.maximum(1 - 2 * np.sum(followed**2, axis=-1), _LEAST_FREE)
    opposed = seen * (residual - _take(residual, across)) * np.float32(np.sqrt(0.5))
    spread = np.sqrt(_fit_variance(opposed**2 / free, looks, seen))
    windows = max(_ENOUGH_PIXELS * len(seen) / max(seen.sum(), 1.0), 1.0)
    some = slice(None, None, int(np.ceil(len(seen) / windows)))
    shared = _shared_noise(pixels.take(some), (opposed / spread)[some], followed[some], seen[some])
    by_pixel = rows @ covariance[:, :, place].astype(np.float32)
    moved = spread[..., None] * by_pixel
    white = (moved.mT @ moved).astype(float)
    if np.count_nonzero(shared) == 1:
        return white
    moved = pixels.lay_out(moved)
    summed = np.array([cv2.filter2D(tile, -1, shared, borderType=_EMPTY) for tile in moved])
    moved, summed = (each.reshape(len(each), -1, 2).astype(float) for each in (moved, summed))
    return _not_below(moved.mT @ summed, white)


def _take(
    values: Shaped[np.ndarray, "n k *p"], index: Int[np.ndarray, "n k"]
) -> Shaped[np.ndarray, "n k *p"]:
    """Of each window the values of some of its pixels."""
    return values[np.arange(len(values))[:, None], index]


def _fit_variance(
    squared: Float[np.ndarray, "n k"],
    looks: Float[np.ndarray, "n k f"],
    used: Float[np.ndarray, "n k"],
) -> Float[np.ndarray, "n k"]:
    """Of each pixel, by a sum of functions whose squared misfit to the squares is least."""
    columns = (looks * used[..., None]).astype(float)
    information = columns.mT @ columns
    size = np.einsum("nff->n", information)[:, None, None]
    shares = np.linalg.solve(
        information + 1e-9 * size * np.eye(looks.shape[-1]),
        columns.mT @ (squared * used)[..., None],
    )
    count = np.maximum(used.sum(axis=1, keepdims=True), 1)
    mean = (squared * used).sum(axis=1, keepdims=True) / count
    variance = (looks @ shares)[..., 0]
    return np.maximum(variance, _LEAST_FREE * mean + 1e-12).astype(np.float32)


def _shared_noise(
    pixels: WindowPixels,
    standard: Float[np.ndarray, "n k"],
    followed: Float[np.ndarray, "n k p"],
    used: Float[np.ndarray, "n k"],
) -> Float[np.ndarray, "l l"]:
    """Covariance of all windows' noise by the distance of two pixels, 0 in the middle.

    What cannot be told from none, of all distances together or of one, is 0: the sum over all would
    else be noise.

    followed : halves that change sign of columns q of which H is the sum of q q^T. Of noise that
        changes sign H takes twice as much as of any.
    """
    reach = TUNING.photometric.shared_reach_px
    near_by, size = pixels.neighbours(reach), (2 * reach + 1,) * 2

    def take_neighbours(values: Float[np.ndarray, "n k *p"]) -> Float[np.ndarray, "l m"]:
        ended = np.concatenate([values, np.zeros_like(values[:, :1])], axis=1)
        ended = ended.reshape(-1, *values.shape[2:])
        return np.take(ended, near_by, axis=0).reshape(len(near_by), -1)

    counts = np.maximum(take_neighbours(used) @ used.ravel(), 1.0)
    least = TUNING.photometric.significant_sigmas / np.sqrt(counts)
    observed = take_neighbours(standard) @ standard.ravel() / counts
    none = np.zeros_like(observed)
    none[len(none) // 2] = 1.0
    # Each distance counts twice, as its opposite.
    lags, told = len(none) // 2, 0.5 * np.sum((observed**2 * counts)[none == 0])
    if told < lags + TUNING.photometric.significant_sigmas * np.sqrt(2 * lags):
        return none.reshape(size)
    shared, near = none, take_neighbours(followed)
    for _ in range(_ROUNDS):
        spread = used[..., None] * (shared @ near).reshape(followed.shape)
        lost = 2 * spread - followed @ (followed.mT @ spread)
        lost = near @ lost.ravel()
        expected = shared - (lost + lost[::-1]) / counts
        shared = shared + observed - expected
        if np.all(np.abs(observed - expected) < _SETTLED * least):
            break
    return np.where(np.abs(shared) < least, 0.0, shared).astype(np.float32).reshape(size)


def _not_below(
    total: Float[np.ndarray, "n q q"], white: Float[np.ndarray, "n q q"]
) -> Float[np.ndarray, "n q q"]:
    """A covariance, in no direction below the least share of that by independent noise:
    correlations that were measured make it negative else."""
    size = np.einsum("nqq->n", white)[:, None, None]
    root = np.linalg.cholesky(white + 1e-12 * size * np.eye(white.shape[-1]))
    inverse = np.linalg.inv(root)
    values, vectors = np.linalg.eigh(inverse @ total @ inverse.mT)
    kept = np.maximum(values, TUNING.photometric.least_spread)
    columns = root @ (vectors * np.sqrt(kept)[:, None])
    return columns @ columns.mT
