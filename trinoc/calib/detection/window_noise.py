"""How far noise moves what is fitted to windows of a picture, by the residuals that are left.

Noise varies over a window, with the light and where the model is wrong, and neighbours share it:
cameras remove noise, interpolate a mosaic, compress. The covariance is then a sandwich (H. White,
"A heteroskedasticity-consistent covariance matrix estimator", Econometrica 48(4), 1980), its middle
from the residuals' variance as it changes over a window, and from their correlation in all.

A fit follows noise, and smooth noise most: what residuals lack of it is H R + R H - H R H for noise
of correlation R, where H projects on what is fitted. It is given back.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.tuning.every_group import TUNING

# numerical: a residual says so little of itself where the fit follows it.
_LEAST_FREE = 0.1
# numerical: rounds in which the correlation is found, and as many windows as it is found in.
_ROUNDS, _MOST_WINDOWS = 5, 16
_EMPTY = cv2.BORDER_CONSTANT  # nothing lies beyond a window


def sandwich_covariance(
    residual: Float[np.ndarray, "n side side"],
    rows: Float[np.ndarray, "n side side p"],
    used: Bool[np.ndarray, "n side side"],
    looks: Float[np.ndarray, "n side side f"],
    covariance: Float[np.ndarray, "n p p"],
    wanted: slice,
) -> Float[np.ndarray, "n q q"]:
    """Covariance of the `wanted` parameters of each window.

    residual, rows : at the end of a fit, and its derivatives by the parameters; 0 where not `used`.
    looks : functions over the window that the noise's variance is a sum of.
    covariance : of the parameters, were the noise independent and of unit variance.
    """
    by_pixel = rows @ covariance[:, None, :, wanted].astype(np.float32)
    followed = rows @ np.linalg.cholesky(covariance).astype(np.float32)[:, None]
    free = np.maximum(1 - np.sum(followed**2, axis=-1), _LEAST_FREE)
    seen = used.astype(np.float32)
    spread = np.sqrt(_fit_variance(residual**2 / free, looks, seen))
    shared = _shared_noise(residual / spread, followed, seen)
    moved = spread[..., None] * by_pixel
    summed = _sum_neighbours(moved, shared)
    moved, summed = (e.reshape(len(e), -1, e.shape[-1]).astype(float) for e in (moved, summed))
    return _not_below(moved.mT @ summed, moved.mT @ moved)


def _fit_variance(
    squared: Float[np.ndarray, "n side side"],
    looks: Float[np.ndarray, "n side side f"],
    used: Float[np.ndarray, "n side side"],
) -> Float[np.ndarray, "n side side"]:
    """Of each pixel, by a sum of functions whose squared misfit to the squares is least."""
    columns = (looks * used[..., None]).reshape(len(used), -1, looks.shape[-1]).astype(float)
    information = columns.mT @ columns
    size = np.einsum("nff->n", information)[:, None, None]
    shares = np.linalg.solve(
        information + 1e-9 * size * np.eye(looks.shape[-1]),
        columns.mT @ (squared * used).reshape(len(used), -1, 1),
    )
    count = np.maximum(used.sum(axis=(1, 2)), 1)
    mean = ((squared * used).sum(axis=(1, 2)) / count)[:, None, None]
    variance = (looks @ shares[:, None])[..., 0]
    return np.maximum(variance, _LEAST_FREE * mean + 1e-12).astype(np.float32)


def _shared_noise(
    standard: Float[np.ndarray, "n side side"],
    followed: Float[np.ndarray, "n side side p"],
    used: Float[np.ndarray, "n side side"],
) -> Float[np.ndarray, "l l"]:
    """Covariance of all windows' noise by the distance of two pixels, 0 in the middle.

    What cannot be told from none is 0: the sum over all distances would else be noise.

    followed : columns q of which H is the sum of q q^T.
    """
    some = slice(None, None, -(-len(used) // _MOST_WINDOWS))
    standard, followed, used = standard[some], followed[some], used[some]
    columns = np.moveaxis(followed, -1, 0)
    counts = np.maximum(_sum_products(used, used), 1.0)
    observed = _sum_products(standard, standard) / counts
    none = np.zeros_like(observed)
    none[len(none) // 2, len(none) // 2] = 1.0
    shared = none
    for _ in range(_ROUNDS):
        spread = used * np.moveaxis(_sum_neighbours(followed, shared), -1, 0)
        inner = np.einsum("anyx,bnyx->nab", columns, spread)
        lost = 2 * spread - np.einsum("anyx,nab->bnyx", columns, inner)
        expected = shared - _sum_products(columns, lost) / counts
        shared = shared + observed - expected
    least = TUNING.photometric.significant_sigmas / np.sqrt(counts)
    return np.where(np.abs(shared) < least, 0.0, shared).astype(np.float32)


def _sum_neighbours(
    values: Float[np.ndarray, "n side side p"], shared: Float[np.ndarray, "l l"]
) -> Float[np.ndarray, "n side side p"]:
    """Around each pixel, weighted by their distance to it."""
    return np.array([cv2.filter2D(one, -1, shared, borderType=_EMPTY) for one in values])


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
