"""Grey levels beside the segments, and their density among all segments of their image."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import SideTuning

# numerical: ends of the histogram, in hundredths of the range of all levels; what lies beyond
# counts there.
_LEAST, _MOST = -10.0, 110.0
# numerical: columns of a table: five of levels, two of contrasts.
SIDE_COLUMNS = 7


def side_table(
    levels: Sequence[Float[np.ndarray, "_ 2"]],
    contrasts: Sequence[Float[np.ndarray, "_"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning = DEFAULT.sides,
) -> list[Float[np.ndarray, "_ 7"]]:
    """Per view: what is known of the grey levels beside each segment, NaN where nothing is.

    Columns are the levels on the right and on the left, in hundredths of the range of all, and the
    log densities under clutter of the right, of the left and of both together; then, of segments
    whose levels are not known, the size of the step between the two, in hundredths of the largest,
    and its log density. About each segment, a density is that of the nearby segments or of the
    image, whichever is larger.
    """
    known = (np.isfinite(view).any() for view in (*levels, *contrasts))
    if not any(known):
        return [np.full((len(view), SIDE_COLUMNS), np.nan) for view in levels]
    unknown = [
        np.where(_are_known(own), np.nan, np.abs(contrast))
        for own, contrast in zip(levels, contrasts, strict=True)
    ]
    both = zip(
        _level_tables(levels, middles_px, tuning),
        _contrast_tables(unknown, middles_px, tuning),
        strict=True,
    )
    return [np.concatenate(tables, axis=1) for tables in both]


def _level_tables(
    levels: Sequence[Float[np.ndarray, "_ 2"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning,
) -> list[Float[np.ndarray, "_ 5"]]:
    every = np.concatenate([view[_are_known(view)] for view in levels])
    if len(every) == 0:
        return [np.full((len(view), 5), np.nan) for view in levels]
    low, high = np.percentile(every, tuning.percentiles)
    unit = max(float(high - low), 1e-9) / 100
    tables = []
    for view, middle in zip(levels, middles_px, strict=True):
        table, known = np.full((len(view), 5), np.nan), _are_known(view)
        own = (view[known] - low) / unit
        usual = np.maximum(_in_image(own, tuning), _nearby(own, middle[known], tuning))
        table[known] = np.column_stack([own, np.log(usual)])
        tables.append(table)
    return tables


def _contrast_tables(
    contrasts: Sequence[Float[np.ndarray, "_"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning,
) -> list[Float[np.ndarray, "_ 2"]]:
    every = np.concatenate([view[np.isfinite(view)] for view in contrasts])
    tables = [np.full((len(view), 2), np.nan) for view in contrasts]
    if len(every) == 0:
        return tables
    unit = max(float(np.percentile(every, tuning.percentiles[1])), 1e-9) / 100
    for table, view, middle in zip(tables, contrasts, middles_px, strict=True):
        known = np.isfinite(view)
        own = view[known] / unit
        usual = np.maximum(_steps_in_image(own, tuning), _steps_nearby(own, middle[known], tuning))
        table[known] = np.column_stack([own, np.log(usual)])
    return tables


def _are_known(levels: Float[np.ndarray, "n 2"]) -> np.ndarray:
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
    both = _smooth(counts + counts.T)
    even = (_MOST - _LEAST) ** -2
    both = (1 - any_level) * both / (both.sum() * width**2) + any_level * even
    one = both.sum(axis=0) * width
    right, left = ((inside - _LEAST) // width).astype(np.int64).T
    return np.column_stack([one[right], one[left], both[right, left]])


def _smooth(counts: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """A histogram under a Gaussian of one bin, as `scipy.ndimage` has it, whose import takes a
    tenth of a second."""
    return cv2.GaussianBlur(counts, (9, 9), 1.0, borderType=cv2.BORDER_REPLICATE)


def _nearby(
    levels: Float[np.ndarray, "n 2"], middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> Float[np.ndarray, "n 3"]:
    """The same among the nearest segments of each."""
    near = _nearest(middles_px, tuning)
    if near.shape[1] == 0:
        return np.zeros((len(levels), 3))
    apart = levels[:, None, :, None] - levels[near][:, :, None, :]
    # As narrow as levels can agree, so that levels which are the same everywhere say nothing.
    width = tuning.agreeing[0]
    kernel = np.exp(-0.5 * (apart / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    both = kernel[..., 0, 0] * kernel[..., 1, 1] + kernel[..., 0, 1] * kernel[..., 1, 0]
    one = kernel.sum(axis=3)
    return np.column_stack([one.mean(axis=1), both.mean(axis=1)]) / 2


def _steps_in_image(contrast: Float[np.ndarray, "n"], tuning: SideTuning) -> np.ndarray:
    """Density of each contrast among the segments of one picture."""
    if len(contrast) == 0:
        return np.zeros(0)
    width, any_level = tuning.bin_width, tuning.any_level_share
    bins = np.arange(0.0, _MOST + width, width)
    inside = np.clip(contrast, 0.0, _MOST - 1e-6)
    counts = _smooth(np.histogram(inside, bins)[0].astype(float)[:, None])[:, 0]
    density = (1 - any_level) * counts / (counts.sum() * width) + any_level / _MOST
    return density[(inside // width).astype(np.int64)]


def _steps_nearby(
    contrast: Float[np.ndarray, "n"], middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> np.ndarray:
    """The same among the nearest segments of each."""
    near = _nearest(middles_px, tuning)
    # Two levels differ by as much as each of them may.
    width = np.sqrt(2) * tuning.agreeing[0]
    kernel = np.exp(-0.5 * ((contrast[:, None] - contrast[near]) / width) ** 2)
    return kernel.sum(axis=1) / (max(near.shape[1], 1) * np.sqrt(2 * np.pi) * width)


def _nearest(middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning) -> np.ndarray:
    """Numbers of the segments nearest to each; none where there are hardly any."""
    count = min(tuning.neighbours, len(middles_px) - 1)
    if count < 2:
        return np.zeros((len(middles_px), 0), dtype=np.int64)
    return np.asarray(KDTree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
