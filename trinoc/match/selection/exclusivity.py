"""Each part of a segment belongs to one line at most: which candidates exclude each other."""

from bisect import bisect_left
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.tuning import DEFAULT, SelectionTuning
from trinoc.numerics import expand_ranges, pairs_of_equal_keys


class ConflictGraph(NamedTuple):
    """Directed edges, sorted by slot = candidate * views + view.

    slot : who is limited, and through which segment. rival_slot : by whom.
    """

    slot: Int[np.ndarray, "e"]
    rival_slot: Int[np.ndarray, "e"]
    views: int


def conflict_graph(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> ConflictGraph:
    """Which candidates claim the same part of a segment; -1 in `index` claims nothing.

    Two candidates that share parts in several views conflict once, in the first of these.
    """
    views = index.shape[1]
    # The interval on each segment, from low to high.
    low, high = interval.min(axis=2), interval.max(axis=2)

    def clash(m: Int[np.ndarray, "e"], n: Int[np.ndarray, "e"], view: int) -> np.ndarray:
        bounds = low[m, view], high[m, view], low[n, view], high[n, view]
        return _clash(*bounds, tuning.conflict_overlap)

    slots, rivals = [np.zeros(0, np.int32)], [np.zeros(0, np.int32)]
    for view in range(views):
        seen = np.flatnonzero(index[:, view] >= 0)
        for m, n in pairs_of_equal_keys(index[seen, view]):
            m, n = seen[m], seen[n]
            fresh = clash(m, n, view)
            m, n = m[fresh], n[fresh]
            for earlier in range(view):
                both = (index[m, earlier] == index[n, earlier]) & (index[m, earlier] >= 0)
                counted = both & clash(m, n, earlier)
                m, n = m[~counted], n[~counted]
            m, n = ((x * views + view).astype(np.int32) for x in (m, n))
            slots += [m, n]
            rivals += [n, m]
    # Both in one number: sorting it is several times faster than by slot.
    edges = np.concatenate(slots).astype(np.int64) << 32
    edges |= np.concatenate(rivals)
    edges.sort()
    return ConflictGraph((edges >> 32).astype(np.int32), edges.astype(np.int32), views)


def affordable(
    log_odds: Float[np.ndarray, "m"],
    index: Int[np.ndarray, "m v"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> Int[np.ndarray, "k"]:
    """Rows of the likeliest candidates: all, or those with as many conflicts as memory bears."""

    def conflicts(least: float) -> int:
        rows = index[log_odds >= least]
        every = (np.bincount(rows[rows[:, view] >= 0, view]) for view in range(index.shape[1]))
        return sum(int((count**2).sum()) for count in every)

    least = -np.inf
    if conflicts(least) > tuning.most_conflicts:
        ordered = np.sort(log_odds)
        fits = bisect_left(ordered, True, key=lambda odds: conflicts(odds) <= tuning.most_conflicts)
        least = ordered[min(fits, len(ordered) - 1)]
    return np.flatnonzero(log_odds >= least)


def claimed(
    index: Int[np.ndarray, "m v"],
    interval: Float[np.ndarray, "m v 2"],
    by_index: Int[np.ndarray, "t v"],
    by_part: Float[np.ndarray, "t v 2"],
    tuning: SelectionTuning = DEFAULT.selection,
) -> Bool[np.ndarray, "m"]:
    """Whether candidates need a part of a segment that one of other lines has."""
    taken = np.zeros(len(index), dtype=bool)
    for view in range(index.shape[1]):
        owners = np.argsort(by_index[:, view], kind="stable")
        segments = by_index[owners, view]
        seen = np.flatnonzero(index[:, view] >= 0)
        m, position = expand_ranges(
            np.searchsorted(segments, index[seen, view], "left"),
            np.searchsorted(segments, index[seen, view], "right"),
        )
        m, by = seen[m], owners[position]
        own, other = interval[m, view], by_part[by, view]
        bounds = own.min(axis=1), own.max(axis=1), other.min(axis=1), other.max(axis=1)
        clash = _clash(*bounds, tuning.conflict_overlap)
        taken[m[clash]] = True
    return taken


def _clash(
    low: Float[np.ndarray, "e"],
    high: Float[np.ndarray, "e"],
    other_low: Float[np.ndarray, "e"],
    other_high: Float[np.ndarray, "e"],
    least_share: float,
) -> Bool[np.ndarray, "e"]:
    shared = np.minimum(high, other_high) - np.maximum(low, other_low)
    return shared > least_share * np.minimum(high - low, other_high - other_low)
