"""Grey levels beside the segments, and their density among all segments of their image."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

from trinoc.match.tuning import DEFAULT, SideTuning

# Ends of the histogram, in hundredths of the range of all levels; what lies beyond counts there.
_LEAST, _MOST = -10.0, 110.0


def side_table(
    levels: Sequence[Float[np.ndarray, "_ 2"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning = DEFAULT.sides,
) -> list[Float[np.ndarray, "_ 5"]]:
    """Per view: levels on the right and on the left, and their log density under clutter.

    Columns are right and left, in hundredths of the range of all, and the log densities of the
    right, of the left and of both together; NaN where the levels are not known. About each
    segment, the density is that of the nearby segments or of the image, whichever is larger.
    """
    every = np.concatenate([view[_known(view)] for view in levels])
    if len(every) == 0:
        return [np.full((len(view), 5), np.nan) for view in levels]
    low, high = np.percentile(every, tuning.percentiles)
    unit = max(float(high - low), 1e-9) / 100
    tables = []
    for view, middle in zip(levels, middles_px, strict=True):
        table, known = np.full((len(view), 5), np.nan), _known(view)
        own = (view[known] - low) / unit
        usual = np.maximum(_in_image(own, tuning), _nearby(own, middle[known], tuning))
        table[known] = np.column_stack([own, np.log(usual)])
        tables.append(table)
    return tables


def _known(levels: Float[np.ndarray, "n 2"]) -> np.ndarray:
    return np.isfinite(levels[:, 0] + levels[:, 1])


def _in_image(levels: Float[np.ndarray, "n 2"], tuning: SideTuning) -> Float[np.ndarray, "n 3"]:
    """Density of the right, of the left and of both, among the segments of one picture."""
    if len(levels) == 0:
        return np.zeros((0, 3))
    width, any_level = tuning.bin_width, tuning.any_level_share
    bins = np.arange(_LEAST, _MOST + width, width)
    inside = np.clip(levels, _LEAST, _MOST - 1e-6)
    counts = np.histogram2d(inside[:, 0], inside[:, 1], bins=[bins, bins])[0]
    # Either way round: which of its ends comes first means nothing.
    both = gaussian_filter(counts + counts.T, 1.0, mode="nearest")
    even = (_MOST - _LEAST) ** -2
    both = (1 - any_level) * both / (both.sum() * width**2) + any_level * even
    one = both.sum(axis=0) * width
    right, left = ((inside - _LEAST) // width).astype(np.int64).T
    return np.column_stack([one[right], one[left], both[right, left]])


def _nearby(
    levels: Float[np.ndarray, "n 2"], middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> Float[np.ndarray, "n 3"]:
    """The same among the nearest segments of each."""
    count = min(tuning.neighbours, len(levels) - 1)
    if count < 2:
        return np.zeros((len(levels), 3))
    near = np.asarray(KDTree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
    apart = levels[:, None, :, None] - levels[near][:, :, None, :]
    # As narrow as levels can agree, so that levels which are the same everywhere say nothing.
    width = tuning.agreeing[0]
    kernel = np.exp(-0.5 * (apart / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    both = kernel[..., 0, 0] * kernel[..., 1, 1] + kernel[..., 0, 1] * kernel[..., 1, 0]
    one = kernel.sum(axis=3)
    return np.column_stack([one.mean(axis=1), both.mean(axis=1)]) / 2
