"""The noise of a picture: cut off by saturation, by grey level, and as neighbours share it."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtr

from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace
from trinoc.numerics.tails import MAD_TO_SIGMA

# numerical: so many sigmas below, saturation does nothing.
_FAR_BELOW = 8.0
_BINS = 8  # numerical: nodes of a function of the grey level
# numerical: rounding to whole levels leaves as much, and a fit must not trust fewer.
LEAST_SIGMA = 0.3
REACH_PX = TUNING.photometric.shared_reach_px


class ClippedMoments(NamedTuple):
    """Of min(x, top) for a normal x.

    Fields
    ------
    mean : expectation.
    slope : its derivative by the mean of x.
    sigma : standard deviation.
    """

    mean: Float[ArrayLike, "n"]
    slope: Float[ArrayLike, "n"]
    sigma: Float[ArrayLike, "n"]


def clipped_moments(
    level: Float[ArrayLike, "n"], sigma: Float[ArrayLike, "n"], top: ScalarLike
) -> ClippedMoments:
    """Moments of a level with noise, cut off at `top` (infinity: nowhere).

    Works on NumPy and on JAX arrays alike, in their own precision: everything is about `top`.
    """
    math = array_namespace(level, sigma)
    normal = ndtr if math is np else jax.scipy.special.ndtr
    z = math.minimum((top - level) / sigma, _FAR_BELOW)
    below, density = normal(z), math.exp(-0.5 * z * z) * 0.3989422804014327
    gap = z * below + density
    cut_off = TUNING.photometric.cut_off_levels**2
    variance = sigma * sigma * math.maximum((z * z + 1) * below + z * density - gap * gap, 0.0)
    sure = z >= _FAR_BELOW
    return ClippedMoments(
        math.where(sure, level, top - sigma * gap),
        math.where(sure, math.ones_like(level), below),
        math.where(sure, sigma, math.sqrt(variance + (1 - below) * cut_off)),
    )


def is_clear(
    level: Float[np.ndarray, "n"], sigma: Float[np.ndarray, "n"], top: float
) -> np.ndarray:
    """Whether saturation leaves the noise of a level as it is."""
    return level < top - TUNING.photometric.clear_sigmas * sigma


def saturation_level(grey: Float[np.ndarray, "n"]) -> float:
    """The largest grey level, if pixels pile up there as saturated ones do; else infinity."""
    top = float(grey.max())
    return top if np.mean(grey >= top - 0.5) > TUNING.photometric.piled_share else np.inf


def white_level(image: Float[np.ndarray, "h w"]) -> float:
    """Grey level of a full signal: of the fewest bits that hold the picture, 8 at least."""
    return float(2 ** max(int(np.ceil(np.log2(float(image.max()) + 1))), 8) - 1)


def noise_by_level(
    level: Float[np.ndarray, "n"],
    residual: Float[np.ndarray, "n"],
    used: Bool[np.ndarray, "n"],
    at: Float[np.ndarray, "m"],
    *,
    robust: bool = False,
) -> Float[np.ndarray, "m"]:
    """Standard deviation of the noise at grey levels, linear in between in variance.

    level, residual : predicted by the fit, and left over; of `used` pixels.
    robust : by medians, where outliers are still among them.
    """
    seen, left, fewest = level[used], residual[used], TUNING.photometric.fewest_pixels
    if len(seen) < fewest:
        return np.full(len(at), max(float(np.std(residual)), LEAST_SIGMA))
    low, high = np.percentile(seen, [2, 98])
    edges = np.linspace(low, high, _BINS + 1)
    bins = np.clip(np.digitize(seen, edges) - 1, 0, _BINS - 1)
    count = np.bincount(bins, minlength=_BINS)
    enough = np.flatnonzero(count >= fewest)
    if not len(enough):
        return np.full(len(at), max(float(np.std(left)), LEAST_SIGMA))
    if robust:
        sizes = [np.median(np.abs(left[bins == k])) for k in enough]
        variance = (MAD_TO_SIGMA * np.array(sizes)) ** 2
    else:
        variance = (np.bincount(bins, left**2, minlength=_BINS) / np.maximum(count, 1))[enough]
    middles = 0.5 * (edges[1:] + edges[:-1])[enough]
    return np.maximum(np.sqrt(np.interp(at, middles, variance)), LEAST_SIGMA)


class OnGrid:
    """Scattered pixels, and which of them are neighbours."""

    def __init__(self, column: Int[np.ndarray, "n"], row: Int[np.ndarray, "n"]) -> None:
        self._place = (row - row.min() + REACH_PX, column - column.min() + REACH_PX)
        size = [int(part.max()) + 1 + REACH_PX for part in self._place]
        self._index = np.full(size, -1, dtype=np.int32)
        self._index[self._place] = np.arange(len(row), dtype=np.int32)

    def neighbours(self, down: int, right: int) -> Int[np.ndarray, "n"]:
        """Which pixel lies so far from each, up to `REACH_PX`; -1 where none was chosen."""
        row, column = self._place
        return self._index[row + down, column + right]

    def pairs(self, down: int, right: int) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
        """All pixels that have such a neighbour, and these."""
        there = self.neighbours(down, right)
        here = np.flatnonzero(there >= 0)
        return here, there[here]


def autocorrelation(
    grid: OnGrid, residual: Float[np.ndarray, "n"], kept: Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "9 9"]:
    """Correlation of residuals by the distance of their pixels, lag 0 in the middle.

    What cannot be told from none is 0: the sum over all lags would else be noise.
    """
    standing = residual * kept
    sums, counts = np.zeros((2, 2 * REACH_PX + 1, 2 * REACH_PX + 1))
    for down, right in _half_of_the_lags():
        here, there = grid.pairs(down, right)
        for at in ((down, right), (-down, -right)):
            sums[REACH_PX + at[0], REACH_PX + at[1]] = standing[here] @ standing[there]
            counts[REACH_PX + at[0], REACH_PX + at[1]] = np.count_nonzero(kept[here] & kept[there])
    counts = np.maximum(counts, 1.0)
    variance = max(sums[REACH_PX, REACH_PX] / counts[REACH_PX, REACH_PX], 1e-12)
    correlation = sums / counts / variance
    correlation[np.abs(correlation) < TUNING.photometric.significant_sigmas / np.sqrt(counts)] = 0.0
    correlation[REACH_PX, REACH_PX] = 1.0
    return correlation


def inflation(correlation: Float[np.ndarray, "9 9"]) -> float:
    """By how much the variance of a mean of neighbours is larger than without correlation."""
    return max(float(correlation.sum()), 1.0)


def sum_correlated(
    grid: OnGrid, rows: Float[np.ndarray, "p n"], correlation: Float[np.ndarray, "9 9"]
) -> Float[np.ndarray, "p p"]:
    """Sum over all pairs of pixels of row_i correlation_ij row_j^T.

    The middle of a sandwich covariance, for rows over the noise's standard deviation.
    """
    spread = np.zeros_like(rows)
    for down, right in (np.argwhere(correlation) - REACH_PX).tolist():
        here, there = grid.pairs(down, right)
        spread[:, here] += correlation[REACH_PX + down, REACH_PX + right] * rows[:, there]
    total = rows @ spread.T
    return 0.5 * (total + total.T)


def _half_of_the_lags() -> list[tuple[int, int]]:
    """(down, right) of one of each two opposite lags, and of none."""
    reach = range(-REACH_PX, REACH_PX + 1)
    return [(down, right) for down in reach for right in reach if (down, right) >= (0, 0)]
