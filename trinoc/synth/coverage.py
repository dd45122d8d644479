"""How much of each cell of a grid a figure covers, from its level at the cells' centres."""

import numpy as np
from jaxtyping import Float


def coverage_of_points(level: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """1 where the level is below zero, else 0; also 0 where it is NaN."""
    return (level < 0).astype(np.float64)


def coverage_of_cells(level: Float[np.ndarray, "m s s"]) -> Float[np.ndarray, "m s s"]:
    """Share of each square cell where the level is below zero; 0 where the level is NaN.

    Exact where the boundary is straight within the cell: then the level over the cell is the
    sum of two uniform variables, as wide as the level changes along each side, and the share
    is their distribution function at zero.
    """
    low, high = level.min(axis=(1, 2)), level.max(axis=(1, 2))
    # A boundary further from the centres than they differ among themselves cuts no cell.
    cut = (2 * low < high) & (2 * high > low)
    share = coverage_of_points(level)
    share[cut] = _share(level[cut])
    return share


def _share(level: Float[np.ndarray, "m s s"]) -> Float[np.ndarray, "m s s"]:
    down, across = (np.abs(change) for change in np.gradient(level, axis=(1, 2)))
    wide = np.maximum(np.maximum(down, across), 1e-12)
    # Below this ratio the trapezium is a box to rounding, and its formula would lose digits.
    narrow = np.maximum(np.minimum(down, across), 1e-4 * wide)
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    share = _ramp(outer - level) - _ramp(inner - level)
    share += _ramp(-outer - level) - _ramp(-inner - level)
    share = np.nan_to_num(np.clip(share / (2 * wide * narrow), 0.0, 1.0))
    # Off the boundary, where the level may be even, the formula has no digits left.
    return np.where(np.abs(level) > outer, coverage_of_points(level), share)


def _ramp(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0.0) ** 2
