"""Noise of an image: clipping by saturation, dependence on the grey level, correlation."""

from typing import NamedTuple

import jax
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace
from trinoc.numerics.tails import MAD_TO_SIGMA

# numerical: distance below saturation, in sigmas, at which clipping is negligible.
_FAR_BELOW = 8.0
_BINS = 8  # numerical: number of nodes of the noise as a function of the grey level
# numerical: noise by rounding to whole levels, the smallest noise that a fit assumes.
LEAST_SIGMA = 0.3


class Saturation(NamedTuple):
    """Grey level at which a camera clips, with the noise of clipped pixels.

    Attributes
    ----------
    top : saturation level; infinity if no level is clipped.
    clipped_sigma : standard deviation assumed for a clipped level, grey levels.
    """

    top: ScalarLike
    clipped_sigma: ScalarLike


class ClippedMoments(NamedTuple):
    """Mean and standard deviation of min(x, top) for a normally distributed grey level x.

    Attributes
    ----------
    mean : mean after clipping.
    slope : derivative of `mean` with respect to the mean of x.
    sigma : standard deviation after clipping.
    """

    mean: Float[ArrayLike, "n"]
    slope: Float[ArrayLike, "n"]
    sigma: Float[ArrayLike, "n"]


def clipped_moments(
    level: Float[ArrayLike, "n"], sigma: Float[ArrayLike, "n"], saturation: Saturation
) -> ClippedMoments:
    """Mean and standard deviation of noisy grey levels after clipping.

    NumPy and JAX arrays are accepted and keep their precision. The code computes relative to the
    saturation level, to avoid cancellation.

    Parameters
    ----------
    level, sigma : (n,) mean and standard deviation before clipping.
    saturation : the saturation level.
    """
    math, top = array_namespace(level, sigma), saturation.top
    normal = scipy.special.ndtr if math is np else jax.scipy.special.ndtr
    z = math.minimum((top - level) / sigma, _FAR_BELOW)
    below, density = normal(z), math.exp(-0.5 * z * z) * 0.3989422804014327
    gap = z * below + density
    clipped_variance = saturation.clipped_sigma**2
    variance = sigma * sigma * math.maximum((z * z + 1) * below + z * density - gap * gap, 0.0)
    is_unclipped = z >= _FAR_BELOW
    return ClippedMoments(
        math.where(is_unclipped, level, top - sigma * gap),
        math.where(is_unclipped, math.ones_like(level), below),
        math.where(is_unclipped, sigma, math.sqrt(variance + (1 - below) * clipped_variance)),
    )


def is_clear(
    level: Float[np.ndarray, "n"], sigma: Float[np.ndarray, "n"], top: float, clear_sigmas: float
) -> Bool[np.ndarray, "n"]:
    """True for each grey level so far below saturation that clipping does not change its noise.

    Parameters
    ----------
    level, sigma : (n,) mean levels and standard deviations before clipping.
    top : saturation level.
    clear_sigmas : required distance from `top`, in standard deviations.
    """
    return level < top - clear_sigmas * sigma


def saturation_level(grey: Float[np.ndarray, "n"], piled_share: float) -> float:
    """Estimate of the saturation level: the largest grey level, if many pixels have it.

    Parameters
    ----------
    grey : (n,) grey levels.
    piled_share : share of pixels at the largest level above which it counts as saturation.

    Returns
    -------
    The largest level, or infinity if the image is not saturated.
    """
    top = float(grey.max())
    return top if np.mean(grey >= top - 0.5) > piled_share else np.inf


def white_level(image: Float[np.ndarray, "h w"]) -> float:
    """Grey level of full white, 2^bits - 1.

    The number of bits is the smallest one, but at least 8, that can represent all levels of the
    image.
    """
    return float(2 ** max(int(np.ceil(np.log2(float(image.max()) + 1))), 8) - 1)


def noise_by_level(
    level: Float[np.ndarray, "n"],
    residual: Float[np.ndarray, "n"],
    used: Bool[np.ndarray, "n"],
    query_levels: Float[np.ndarray, "m"],
    fewest: int,
    *,
    robust: bool = False,
) -> Float[np.ndarray, "m"]:
    """Standard deviation of the noise as a function of the grey level.

    The variance is estimated in bins of the grey level and interpolated linearly.

    Parameters
    ----------
    level, residual : (n,) predicted grey levels, and residuals.
    used : (n,) mask of the pixels from which the noise is estimated.
    query_levels : (m,) grey levels at which the noise is returned.
    fewest : smallest number of pixels in a bin.
    robust : True to use medians, if the pixels still contain outliers.

    Returns
    -------
    (m,) standard deviations, grey levels.
    """
    levels, residuals = level[used], residual[used]
    if len(levels) < fewest:
        return np.full(len(query_levels), max(float(np.std(residual)), LEAST_SIGMA))
    low, high = np.percentile(levels, [2, 98])
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(levels, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    enough = np.flatnonzero(count >= fewest)
    if not len(enough):
        return np.full(len(query_levels), max(float(np.std(residuals)), LEAST_SIGMA))
    if robust:
        sizes = [np.median(np.abs(residuals[bins == k])) for k in enough]
        variance = (MAD_TO_SIGMA * np.array(sizes)) ** 2
    else:
        variance = (np.bincount(bins, residuals**2, minlength=_BINS) / np.maximum(count, 1))[enough]
    middles = 0.5 * (edges[1:] + edges[:-1])[enough]
    return np.maximum(np.sqrt(np.interp(query_levels, middles, variance)), LEAST_SIGMA)


class PixelGrid:
    """Lookup of the neighbours of selected pixels.

    Parameters
    ----------
    column, row : (n,) coordinates of the selected pixels.
    reach_px : largest offset of a neighbour in each direction.
    """

    def __init__(
        self, column: Int[np.ndarray, "n"], row: Int[np.ndarray, "n"], reach_px: int
    ) -> None:
        self.reach_px = reach_px
        self._position = (row - row.min() + reach_px, column - column.min() + reach_px)
        size = [int(part.max()) + 1 + reach_px for part in self._position]
        self._index = np.full(size, -1, dtype=np.int32)
        self._index[self._position] = np.arange(len(row), dtype=np.int32)

    def neighbours(self, down: int, right: int) -> Int[np.ndarray, "n"]:
        """Index of the pixel `down` rows and `right` columns away from each pixel.

        It is -1 if that pixel is not selected.
        """
        row, column = self._position
        return self._index[row + down, column + right]

    def pairs(self, down: int, right: int) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """Pairs of selected pixels, `down` rows and `right` columns apart.

        Returns
        -------
        (m,) indices of the first pixels, and (m,) indices of their neighbours.
        """
        neighbour = self.neighbours(down, right)
        pixel = np.flatnonzero(neighbour >= 0)
        return pixel, neighbour[pixel]


def autocorrelation(
    grid: PixelGrid,
    residual: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    significant_sigmas: float,
) -> Float[np.ndarray, "l l"]:
    """Correlation of the residuals of two pixels, as a function of their offset.

    Insignificant correlations are set to 0, because their noise would dominate the sum over all
    offsets.

    Parameters
    ----------
    grid : lookup of neighbouring pixels.
    residual : (n,) residuals divided by their standard deviations.
    inliers : (n,) mask of the pixels that are used.
    significant_sigmas : significance below which a correlation is set to 0.

    Returns
    -------
    (l, l) correlations by offset (row, column); the offset 0 is in the centre.
    """
    used_residual, reach = residual * inliers, grid.reach_px
    sums, counts = np.zeros((2, 2 * reach + 1, 2 * reach + 1))
    for down, right in _half_of_the_lags(reach):
        pixel, neighbour = grid.pairs(down, right)
        product = used_residual[pixel] @ used_residual[neighbour]
        count = np.count_nonzero(inliers[pixel] & inliers[neighbour])
        for sign in (1, -1):
            sums[reach + sign * down, reach + sign * right] = product
            counts[reach + sign * down, reach + sign * right] = count
    counts = np.maximum(counts, 1.0)
    variance = max(sums[reach, reach] / counts[reach, reach], 1e-12)
    correlation = sums / counts / variance
    correlation[np.abs(correlation) < significant_sigmas / np.sqrt(counts)] = 0.0
    correlation[reach, reach] = 1.0
    return correlation


def inflation(correlation: Float[np.ndarray, "l l"]) -> float:
    """Variance of a mean over many neighbouring pixels, divided by that for uncorrelated pixels.

    correlation : (l, l) correlation by offset, see `autocorrelation`.
    """
    return max(float(correlation.sum()), 1.0)


def sum_correlated(
    grid: PixelGrid, rows: Float[np.ndarray, "p n"], correlation: Float[np.ndarray, "l l"]
) -> Float[np.ndarray, "p p"]:
    """Sum of row_i correlation_ij row_j^T over all pairs (i, j) of pixels.

    The result is the middle matrix of a sandwich covariance.

    Parameters
    ----------
    grid : lookup of neighbouring pixels.
    rows : (p, n) derivatives of the pixels with respect to p parameters, divided by the standard
        deviation of the noise.
    correlation : (l, l) correlation by offset, see `autocorrelation`.
    """
    spread, reach = np.zeros_like(rows), grid.reach_px
    for down, right in (np.argwhere(correlation) - reach).tolist():
        pixel, neighbour = grid.pairs(down, right)
        spread[:, pixel] += correlation[reach + down, reach + right] * rows[:, neighbour]
    total = rows @ spread.T
    return 0.5 * (total + total.T)


def _half_of_the_lags(reach_px: int) -> list[tuple[int, int]]:
    """Offsets (down, right) up to `reach_px`, with only one of each two opposite offsets."""
    offsets = range(-reach_px, reach_px + 1)
    return [(down, right) for down in offsets for right in offsets if (down, right) >= (0, 0)]
