"""Grey levels beside the segments, and their density among all segments of the image."""

from collections.abc import Sequence

import cv2
import numpy as np
import scipy
from jaxtyping import Float

from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import SideTuning

# numerical: range of the histogram, in hundredths of the range of all levels. Values outside count
# in the first or last bin.
_LOWEST_LEVEL, _HIGHEST_LEVEL = -10.0, 110.0
# numerical: number of columns: five for levels, two for contrasts.
SIDE_COLUMNS = 7


def side_table(
    levels: Sequence[Float[np.ndarray, "_ 2"]],
    contrasts: Sequence[Float[np.ndarray, "_"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning = DEFAULT.sides,
) -> list[Float[np.ndarray, "_ 7"]]:
    """Return the grey levels beside the segments of each view and their densities, (n, 7) each.

    Unknown values are NaN. Columns 0 and 1 are the levels on the right and on the left, as
    percentages of the range of all levels. Columns 2 to 4 are log densities under clutter: of the
    right level, of the left level, and of both together. For segments without levels, column 5 is
    the contrast as a percentage of the largest contrast. Column 6 is its log density. Each density
    is the larger of two: among the nearby segments, or among all segments of the image.
    """
    has_values = (np.isfinite(view).any() for view in (*levels, *contrasts))
    if not any(has_values):
        return [np.full((len(view), SIDE_COLUMNS), np.nan) for view in levels]
    contrasts_without_levels = [
        np.where(_are_known(view_levels), np.nan, np.abs(contrast))
        for view_levels, contrast in zip(levels, contrasts, strict=True)
    ]
    table_pairs = zip(
        _level_tables(levels, middles_px, tuning),
        _contrast_tables(contrasts_without_levels, middles_px, tuning),
        strict=True,
    )
    return [np.concatenate(tables, axis=1) for tables in table_pairs]


def _level_tables(
    levels: Sequence[Float[np.ndarray, "_ 2"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning,
) -> list[Float[np.ndarray, "_ 5"]]:
    all_levels = np.concatenate([view[_are_known(view)] for view in levels])
    if len(all_levels) == 0:
        return [np.full((len(view), 5), np.nan) for view in levels]
    low, high = np.percentile(all_levels, tuning.percentiles)
    unit = max(float(high - low), 1e-9) / 100
    tables = []
    for view, middle in zip(levels, middles_px, strict=True):
        table, is_known = np.full((len(view), 5), np.nan), _are_known(view)
        scaled = (view[is_known] - low) / unit
        density = np.maximum(
            _level_density_in_image(scaled, tuning),
            _level_density_nearby(scaled, middle[is_known], tuning),
        )
        table[is_known] = np.column_stack([scaled, np.log(density)])
        tables.append(table)
    return tables


def _contrast_tables(
    contrasts: Sequence[Float[np.ndarray, "_"]],
    middles_px: Sequence[Float[np.ndarray, "_ 2"]],
    tuning: SideTuning,
) -> list[Float[np.ndarray, "_ 2"]]:
    all_contrasts = np.concatenate([view[np.isfinite(view)] for view in contrasts])
    tables = [np.full((len(view), 2), np.nan) for view in contrasts]
    if len(all_contrasts) == 0:
        return tables
    unit = max(float(np.percentile(all_contrasts, tuning.percentiles[1])), 1e-9) / 100
    for table, view, middle in zip(tables, contrasts, middles_px, strict=True):
        is_known = np.isfinite(view)
        scaled = view[is_known] / unit
        density = np.maximum(
            _contrast_density_in_image(scaled, tuning),
            _contrast_density_nearby(scaled, middle[is_known], tuning),
        )
        table[is_known] = np.column_stack([scaled, np.log(density)])
    return tables


def _are_known(levels: Float[np.ndarray, "n 2"]) -> np.ndarray:
    return np.isfinite(levels[:, 0] + levels[:, 1])


def _level_density_in_image(
    levels: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> Float[np.ndarray, "n 3"]:
    """Probability density of each segment's levels among all segments of an image, (n, 3).

    The columns are the densities of the right level, of the left level, and of both together.
    """
    if len(levels) == 0:
        return np.zeros((0, 3))
    width, any_level = tuning.bin_width, tuning.any_level_share
    bins = np.arange(_LOWEST_LEVEL, _HIGHEST_LEVEL + width, width)
    clipped = np.clip(levels, _LOWEST_LEVEL, _HIGHEST_LEVEL - 1e-6)
    counts = np.histogram2d(clipped[:, 0], clipped[:, 1], bins=[bins, bins])[0]
    # Symmetric, because the order of a segment's ends has no meaning here.
    joint = _smooth(counts + counts.T)
    uniform = (_HIGHEST_LEVEL - _LOWEST_LEVEL) ** -2
    joint = (1 - any_level) * joint / (joint.sum() * width**2) + any_level * uniform
    marginal = joint.sum(axis=0) * width
    right_bin, left_bin = ((clipped - _LOWEST_LEVEL) // width).astype(np.int64).T
    return np.column_stack([marginal[right_bin], marginal[left_bin], joint[right_bin, left_bin]])


def _smooth(counts: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Smooth a histogram with a Gaussian whose standard deviation is one bin.

    OpenCV is used because SciPy's filters take 0.1 s to import.
    """
    return cv2.GaussianBlur(counts, (9, 9), 1.0, borderType=cv2.BORDER_REPLICATE)


def _level_density_nearby(
    levels: Float[np.ndarray, "n 2"], middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> Float[np.ndarray, "n 3"]:
    """Probability density of each segment's levels among nearby segments, (n, 3).

    The columns are the densities of the right level, of the left level, and of both together.
    """
    nearest = _nearest_segments(middles_px, tuning)
    if nearest.shape[1] == 0:
        return np.zeros((len(levels), 3))
    difference = levels[:, None, :, None] - levels[nearest][:, :, None, :]
    # The kernel has the smallest agreement scale. Levels that are equal everywhere then give no
    # evidence.
    width = tuning.agreement_scales[0]
    kernel = np.exp(-0.5 * (difference / width) ** 2) / (np.sqrt(2 * np.pi) * width)
    joint = kernel[..., 0, 0] * kernel[..., 1, 1] + kernel[..., 0, 1] * kernel[..., 1, 0]
    marginal = kernel.sum(axis=3)
    return np.column_stack([marginal.mean(axis=1), joint.mean(axis=1)]) / 2


def _contrast_density_in_image(contrast: Float[np.ndarray, "n"], tuning: SideTuning) -> np.ndarray:
    """Probability density of each segment's contrast among all segments of an image, (n,)."""
    if len(contrast) == 0:
        return np.zeros(0)
    width, any_level = tuning.bin_width, tuning.any_level_share
    bins = np.arange(0.0, _HIGHEST_LEVEL + width, width)
    clipped = np.clip(contrast, 0.0, _HIGHEST_LEVEL - 1e-6)
    counts = _smooth(np.histogram(clipped, bins)[0].astype(float)[:, None])[:, 0]
    density = (1 - any_level) * counts / (counts.sum() * width) + any_level / _HIGHEST_LEVEL
    return density[(clipped // width).astype(np.int64)]


def _contrast_density_nearby(
    contrast: Float[np.ndarray, "n"], middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning
) -> np.ndarray:
    """Probability density of each segment's contrast among nearby segments, (n,)."""
    nearest = _nearest_segments(middles_px, tuning)
    # The difference of two levels has twice the variance of one.
    width = np.sqrt(2) * tuning.agreement_scales[0]
    kernel = np.exp(-0.5 * ((contrast[:, None] - contrast[nearest]) / width) ** 2)
    return kernel.sum(axis=1) / (max(nearest.shape[1], 1) * np.sqrt(2 * np.pi) * width)


def _nearest_segments(middles_px: Float[np.ndarray, "n 2"], tuning: SideTuning) -> np.ndarray:
    """Return the indices of the nearest segments of each segment, (n, k); k is 0 if there are too
    few.
    """
    count = min(tuning.neighbours, len(middles_px) - 1)
    if count < 2:
        return np.zeros((len(middles_px), 0), dtype=np.int64)
    return np.asarray(scipy.spatial.KDTree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
