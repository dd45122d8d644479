"""Levels beside a segment as evidence: in diffuse light a surface is as bright in all views.

Of the two surfaces that meet in an edge both, one (where the other is a background that differs
between views) or none look the same in all pictures. How often each happens, and how nearly the
levels agree, is learned from the pictures at hand by `evidence.learn`.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree

# Levels are counted in hundredths of their range, and agree within one of these, or not at all.
AGREEING = np.array([0.5, 2.0, 6.0])
_NONE = len(AGREEING)
# How the one side agrees and how the other; which is which does not matter.
COMPONENTS = list(combinations_with_replacement(range(_NONE + 1), 2))
PRIOR_SHARES = np.array([0.3, 0.15, 0.05, 0.15, 0.1, 0.04, 0.08, 0.03, 0.04, 0.06])

_PERCENTILES = 2.0, 98.0
# The histogram of a picture, and the share of strangers that have any level.
_LEAST, _MOST, _BIN, _ANY = -10.0, 110.0, 2.0, 0.05
# How many segments are nearby, and the width of the kernel that makes their levels a density: as
# narrow as levels can agree, so that levels which are the same everywhere say nothing.
_NEARBY, _WIDTH = 25, AGREEING[0]


def side_table(
    levels: Sequence[Float[np.ndarray, "_ 2"]], middles_px: Sequence[Float[np.ndarray, "_ 2"]]
) -> list[Float[np.ndarray, "_ 5"]]:
    """Per view: levels on the right and on the left, and how usual they are among strangers.

    Columns are right and left, in hundredths of the range of all, and the log densities of the
    right, of the left and of both together; NaN where the levels are not known. About each
    segment, levels are as usual as they are nearby, or in the picture, whichever is more.
    """
    every = np.concatenate([view[_known(view)] for view in levels])
    if len(every) == 0:
        return [np.full((len(view), 5), np.nan) for view in levels]
    low, high = np.percentile(every, _PERCENTILES)
    unit = max(float(high - low), 1e-9) / 100
    tables = []
    for view, middle in zip(levels, middles_px, strict=True):
        table, known = np.full((len(view), 5), np.nan), _known(view)
        own = (view[known] - low) / unit
        usual = np.maximum(_in_image(own), _nearby(own, middle[known]))
        table[known] = np.column_stack([own, np.log(usual)])
        tables.append(table)
    return tables


def _known(levels: Float[np.ndarray, "n 2"]) -> np.ndarray:
    return np.isfinite(levels[:, 0] + levels[:, 1])


def _in_image(levels: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Density of the right, of the left and of both, among the segments of one picture."""
    if len(levels) == 0:
        return np.zeros((0, 3))
    bins = np.arange(_LEAST, _MOST + _BIN, _BIN)
    inside = np.clip(levels, _LEAST, _MOST - 1e-6)
    counts = np.histogram2d(inside[:, 0], inside[:, 1], bins=[bins, bins])[0]
    # Either way round: which of its ends comes first means nothing.
    both = gaussian_filter(counts + counts.T, 1.0, mode="nearest")
    even = (_MOST - _LEAST) ** -2
    both = (1 - _ANY) * both / (both.sum() * _BIN**2) + _ANY * even
    one = both.sum(axis=0) * _BIN
    right, left = ((inside - _LEAST) // _BIN).astype(np.int64).T
    return np.column_stack([one[right], one[left], both[right, left]])


def _nearby(
    levels: Float[np.ndarray, "n 2"], middles_px: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 3"]:
    """The same among the nearest segments of each."""
    count = min(_NEARBY, len(levels) - 1)
    if count < 2:
        return np.zeros((len(levels), 3))
    near = np.asarray(KDTree(middles_px).query(middles_px, count + 1)[1])[:, 1:]
    apart = levels[:, None, :, None] - levels[near][:, :, None, :]
    kernel = np.exp(-0.5 * (apart / _WIDTH) ** 2) / (np.sqrt(2 * np.pi) * _WIDTH)
    both = kernel[..., 0, 0] * kernel[..., 1, 1] + kernel[..., 0, 1] * kernel[..., 1, 0]
    one = kernel.sum(axis=3)
    return np.column_stack([one.mean(axis=1), both.mean(axis=1)]) / 2


def side_evidence(
    sides: Float[np.ndarray, "v n 5"],
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
) -> Float[np.ndarray, "m s"]:
    """Log density of the members' levels under each of COMPONENTS, over that of strangers.

    Zero where the levels of fewer than two members are known. `sides` is of `side_table`.
    """
    if np.isnan(sides[..., 0]).all():
        return np.zeros((len(index), len(COMPONENTS)))
    own = sides[np.arange(len(sides)), index]
    against = interval[..., 1] < interval[..., 0]
    own = np.where(against[..., None], own[..., [1, 0, 3, 2, 4]], own)
    known = ((index >= 0) & ~np.isnan(own[..., 0]))[..., None]
    own = np.where(known, own, 0.0)
    count = np.maximum(known.sum(axis=1), 1)
    mean = own[..., :2].sum(axis=1) / count
    scatter = (np.where(known, own[..., :2] - mean[:, None], 0.0) ** 2).sum(axis=1)
    # Strangers have a level each, the images of one line share one: of `count` densities one is
    # the line's own.
    strange = own[..., 2:].sum(axis=1) * (count - 1) / count
    alike = (
        -0.5 * scatter[..., None] / AGREEING**2
        - (count - 1)[..., None] * np.log(np.sqrt(2 * np.pi) * AGREEING)
        - 0.5 * np.log(count)[..., None]
    )
    right, left = alike[:, 0], alike[:, 1]
    terms = []
    for one, other in COMPONENTS:
        if other < _NONE:
            terms.append(
                _mean_of(right[:, one] + left[:, other], right[:, other] + left[:, one])
                - strange[:, 2]
            )
        elif one < _NONE:
            terms.append(_mean_of(right[:, one] - strange[:, 0], left[:, one] - strange[:, 1]))
        else:
            terms.append(np.zeros(len(index)))
    return np.where(count > 1, np.stack(terms, axis=1), 0.0)


def _mean_of(one: Float[np.ndarray, "m"], other: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
    """Logarithm of the mean of two, from their logarithms."""
    return np.logaddexp(one, other) - np.log(2)
