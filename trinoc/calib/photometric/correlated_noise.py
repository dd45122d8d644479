"""Noise that neighbouring pixels share, as mosaics, JPEG, denoising and resampling make it."""

import numpy as np
from jaxtyping import Bool, Float, Int

REACH_PX = 4
# A correlation below this many of its standard deviations counts as none.
_SIGNIFICANT = 3.0


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
    correlation[np.abs(correlation) < _SIGNIFICANT / np.sqrt(counts)] = 0.0
    correlation[REACH_PX, REACH_PX] = 1.0
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
