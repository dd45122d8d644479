"""Sums and extremes over runs of consecutive points, the shape in which chains are kept.

A run is the half-open range [start, stop) of the ordered points. Runs may leave points out,
and two neighbours may share the point where a chain was split.
"""

import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.numerics.interval_join import expand_ranges


def members(
    start: Int[np.ndarray, "r"], stop: Int[np.ndarray, "r"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Int[np.ndarray, "r"]]:
    """(index, run, first): every member of every run, its run, and where each run begins."""
    run, index = expand_ranges(start, stop)
    count = stop - start
    return index, run, np.cumsum(count) - count


def sums(values: Float[np.ndarray, "m"], first: Int[np.ndarray, "r"]) -> Float[np.ndarray, "r"]:
    """Sum of each run of the concatenated values; no run may be empty."""
    if len(first) == 0:
        return np.zeros(0, dtype=values.dtype)
    return np.add.reduceat(values, first)


def largest(
    values: Shaped[np.ndarray, "m"], first: Int[np.ndarray, "r"], run: Int[np.ndarray, "m"]
) -> tuple[np.ndarray, Int[np.ndarray, "r"]]:
    """(maximum, position) of each run, the position counted from the run's first member."""
    if len(first) == 0:
        return np.zeros(0, dtype=values.dtype), np.zeros(0, dtype=np.int64)
    top = np.maximum.reduceat(values, first)
    hits = np.flatnonzero(values == top[run])
    position = np.zeros(len(first), dtype=np.int64)
    # Written backwards, so that the first of equal maxima stays.
    position[run[hits[::-1]]] = hits[::-1]
    return top, position - first
