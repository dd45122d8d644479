"""Joining pieces of one straight edge across gaps."""

import numpy as np
from jaxtyping import Bool, Int

from trinoc.numerics import near_pairs
from trinoc.segments.nevatia_babu.chains import ordered_chains
from trinoc.segments.nevatia_babu.line_fit import FittedLines

_LEAST_COSINE = np.cos(np.radians(15.0))


def collinear_successors(
    lines: FittedLines, gap_px: float, tolerance_px: float
) -> Int[np.ndarray, "r"]:
    """(r,) the line that continues each line beyond a gap, -1 where there is none.

    Two lines with their dark sides on the same side continue each other when the gap is at
    most `gap_px` and both inner ends lie within `tolerance_px` of the chord of the outer
    ends. Each line continues at most one and is continued by at most one, the nearest.
    """
    count = len(lines.support)
    successor = np.full(count, -1, dtype=np.int64)
    if count < 2:
        return successor
    ends = lines.endpoints_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], gap_px)
    a, b = lines.direction[one], lines.direction[other]
    along = np.flatnonzero(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] > _LEAST_COSINE)
    one, other, gap = one[along], other[along], gap[along]
    chord = ends[other, 1] - ends[one, 0]
    length = np.linalg.norm(chord, axis=-1)
    normal = np.stack([-chord[:, 1], chord[:, 0]], -1) / np.maximum(length, 1e-9)[:, None]
    deviation = np.maximum(
        *(
            np.abs(to[:, 0] * normal[:, 0] + to[:, 1] * normal[:, 1])
            for to in (ends[one, 1] - ends[one, 0], ends[other, 0] - ends[one, 0])
        )
    )
    part = lines.extent_px[:, 1] - lines.extent_px[:, 0]
    longer_than_parts = length > np.maximum(part[one], part[other])
    allowed = (one != other) & (deviation < tolerance_px) & longer_than_parts
    one, other, gap = one[allowed], other[allowed], gap[allowed]
    nearest = np.lexsort((gap, one))
    nearest = nearest[_first_of_runs(one[nearest])]
    one, other, gap = one[nearest], other[nearest], gap[nearest]
    nearest = np.lexsort((gap, other))
    nearest = nearest[_first_of_runs(other[nearest])]
    successor[one[nearest]] = other[nearest]
    return successor


def _first_of_runs(grouped: Int[np.ndarray, "m"]) -> np.ndarray:
    return np.flatnonzero(np.diff(grouped, prepend=-1))


def bridged_runs(
    successor: Int[np.ndarray, "r"], first: Int[np.ndarray, "r"], count: int
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "g"], Int[np.ndarray, "g"], Bool[np.ndarray, "g"]]:
    """(order, first, earliest, several): the points of merged lines one after another, where
    each begins, and the earliest line in it and whether there are several.

    `first` tells where the points of each line begin now, `count` how many there are.
    """
    line_order, group_start = ordered_chains(successor)
    length = np.diff(np.append(first, count))[line_order]
    begin = np.cumsum(length) - length
    order = np.arange(count) - np.repeat(begin - first[line_order], length)
    several = np.diff(group_start, append=len(line_order)) > 1
    return order, begin[group_start], line_order[group_start], several
