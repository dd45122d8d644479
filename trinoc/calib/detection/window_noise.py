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
from scipy.signal import fftconvolve

from trinoc.calib.tuning.every_group import TUNING

# numerical: a residual says so little of itself where the fit follows it.
_LEAST_FREE = 0.1
# numerical: rounds in which the correlation is found, and as many windows as it is found in.
_ROUNDS, _MOST_WINDOWS = 5, 16
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
    root = np.linalg.cholesky(covariance[:, odd][:, :, odd]).astype(np.float32)
    followed = 0.5 * has[..., None] * (rows[..., odd] - _take(rows[..., odd], across)) @ root
    free = np.maximum(1 - 2 * np.sum(followed**2, axis=-1), _LEAST_FREE)
    seen = has.astype(np.float32)
    opposed = np.sqrt(0.5) * seen * (residual - _take(residual, across))
    spread = np.sqrt(_fit_variance(opposed**2 / free, looks, seen))
    some = slice(None, None, -(-len(seen) // _MOST_WINDOWS))
    lay_out = pixels.take(some).lay_out
    standard, tiles = lay_out((opposed / spread)[some]), lay_out(followed[some])
    shared = _shared_noise(standard, np.moveaxis(tiles, -1, 0), lay_out(seen[some]))
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
    standard: Float[np.ndarray, "n side side"],
    followed: Float[np.ndarray, "p n side side"],
    used: Float[np.ndarray, "n side side"],
) -> Float[np.ndarray, "l l"]:
    """Covariance of all windows' noise by the distance of two pixels, 0 in the middle.

    What cannot be told from none is 0: the sum over all distances would else be noise.

    followed : halves that change sign of columns q of which H is the sum of q q^T. Of noise that
        changes sign H takes twice as much as of any.
    """
    counts = np.maximum(_sum_products(used, used), 1.0)
    least = TUNING.photometric.significant_sigmas / np.sqrt(counts)
    observed = _sum_products(standard, standard) / counts
    none = np.zeros_like(observed)
    none[len(none) // 2, len(none) // 2] = 1.0
    shared, spread = none, followed
    for _ in range(_ROUNDS):
        inner = np.einsum("anyx,bnyx->nab", followed, spread)
        lost = 2 * spread - np.einsum("anyx,nab->bnyx", followed, inner)
        expected = shared - 2 * _sum_products(followed, lost) / counts
        shared = shared + observed - expected
        if not np.any((np.abs(shared) >= least) & (none == 0)):
            return none.astype(np.float32)
        spread = used * fftconvolve(followed, shared[None, None], mode="same", axes=(2, 3))
    return np.where(np.abs(shared) < least, 0.0, shared).astype(np.float32)


def _sum_products(
    one: Float[np.ndarray, "*n side side"], other: Float[np.ndarray, "*n side side"]
) -> Float[np.ndarray, "l l"]:
    """Of all pairs of pixels of one window, by their distance, 0 in the middle (Wiener and
    Khinchin); the mean of two opposite ones."""
    reach, axes = TUNING.photometric.shared_reach_px, (-2, -1)
    # So that no distance goes round.
    length = cv2.getOptimalDFTSize(one.shape[-1] + reach)
    size = (length, length)
    spectra = np.fft.rfft2(one, size).conj() * np.fft.rfft2(other, size)
    sums = np.fft.irfft2(spectra.reshape(-1, *spectra.shape[-2:]).sum(axis=0), size, axes)
    lags = np.arange(-reach, reach + 1)
    sums = sums[np.ix_(lags, lags)]
    return 0.5 * (sums + sums[::-1, ::-1])


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
