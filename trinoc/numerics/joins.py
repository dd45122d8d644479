"""Joins and groups on sorted arrays and of nearby points, by index operations.

A run is a half-open range [start, stop) of ordered points. Runs may skip points, and two neighbours
may share the point at which a chain was split. A group is a number for each row of a table. Without
groups (None), all rows belong to one problem, and results have no group axis.
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from jaxtyping import Float, Int, Shaped

Group = Int[np.ndarray, "m"] | None

# Points per leaf: fastest to build and query for some thousands of points.
_LEAF = 16


def expand_ranges(
    start: Int[np.ndarray, "n"], stop: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """List the integers of all ranges [start[i], stop[i]).

    Parameters
    ----------
    start, stop : (n,)
        Limits of the ranges; `stop` is excluded.

    Returns
    -------
    (m,) index i of the range of each integer, and (m,) the integers.
    """
    count = np.maximum(stop - start, 0)
    owner = np.repeat(np.arange(len(start)), count)
    position = np.take(start - (np.cumsum(count) - count), owner)
    position += np.arange(len(owner))
    return owner, position


def overlapping(
    first: Float[np.ndarray, "n 2"], second: Float[np.ndarray, "m 2"]
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Indices (i, j) of all pairs of overlapping intervals, each pair once.

    Of two overlapping intervals, exactly one starts inside the other. A search in the sorted starts
    therefore finds all pairs, and tests no other pairs.

    Parameters
    ----------
    first, second : (n, 2), (m, 2)
        Two lists of intervals (low, high).

    Returns
    -------
    (p,) indices in `first`, and (p,) indices in `second`.
    """
    order_first, order_second = np.argsort(first[:, 0]), np.argsort(second[:, 0])
    starts_first, starts_second = first[order_first, 0], second[order_second, 0]
    i, position = expand_ranges(
        np.searchsorted(starts_second, first[:, 0], "left"),
        np.searchsorted(starts_second, first[:, 1], "left"),
    )
    j, position_first = expand_ranges(
        np.searchsorted(starts_first, second[:, 0], "right"),
        np.searchsorted(starts_first, second[:, 1], "left"),
    )
    return (
        np.concatenate([i, order_first[position_first]]),
        np.concatenate([order_second[position], j]),
    )


def blocks_of_overlapping(
    first: Float[np.ndarray, "n 2"], second: Float[np.ndarray, "m 2"], pairs_per_block: int
) -> Iterator[slice]:
    """Yield consecutive slices that together cover the intervals `first`.

    The intervals of a slice form about `pairs_per_block` overlapping pairs with the intervals
    `second`. A slice with a single interval may have more pairs. The result is one empty slice if
    `first` is empty.

    Parameters
    ----------
    first, second : (n, 2), (m, 2)
        Two lists of intervals (low, high).
    pairs_per_block : int
        Approximate number of pairs of a slice.
    """
    started = np.searchsorted(np.sort(second[:, 0]), first[:, 1], "left")
    ended = np.searchsorted(np.sort(second[:, 1]), first[:, 0], "right")
    pair_count = np.cumsum(started - ended)
    borders = np.searchsorted(
        pair_count,
        np.arange(pairs_per_block, pair_count[-1] if len(pair_count) else 0, pairs_per_block),
    )
    if len(first) == 0:
        yield slice(0, 0)
    for start, stop in pairwise(np.unique([0, *borders, len(first)]).tolist()):
        yield slice(start, stop)


def pairs_of_equal_keys(
    keys: Int[np.ndarray, "n"], pairs_per_block: int = 1 << 21
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """Yield the indices of all pairs of entries with equal keys, each pair once.

    Parameters
    ----------
    keys : (n,)
        Key of each entry.
    pairs_per_block : int
        Approximate number of pairs that are yielded at once. It bounds the memory.

    Yields
    ------
    (p,) indices of the first entries, and (p,) indices of the second entries.
    """
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.searchsorted(ordered, ordered, "left")
    pair_count = np.cumsum(np.arange(len(ordered)) - first)
    borders = np.searchsorted(
        pair_count, np.arange(0, pair_count[-1] if len(pair_count) else 0, pairs_per_block)
    )
    for start, stop in pairwise([*np.unique(borders).tolist(), len(ordered)]):
        rows = np.arange(start, stop)
        later, earlier = expand_ranges(first[rows], rows)
        yield order[earlier], order[start + later]


def members(
    start: Int[np.ndarray, "r"], stop: Int[np.ndarray, "r"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Int[np.ndarray, "r"]]:
    """List the members of all runs. A run is a range [start, stop) of indices of ordered points.

    Parameters
    ----------
    start, stop : (r,)
        Limits of the runs; `stop` is excluded.

    Returns
    -------
    (m,) index of the point that each member is, (m,) index of the member's run, and (r,) position
    of each run's first member in these two arrays.
    """
    run, index = expand_ranges(start, stop)
    count = stop - start
    return index, run, np.cumsum(count) - count


def group_maxima(
    values: Shaped[np.ndarray, "m"], first: Int[np.ndarray, "r"], run: Int[np.ndarray, "m"]
) -> tuple[np.ndarray, Int[np.ndarray, "r"]]:
    """Maximum of the values of each run, and its position.

    Parameters
    ----------
    values : (m,)
        Value of each member.
    first : (r,)
        Position of the first member of each run.
    run : (m,)
        Index of the run of each member.

    Returns
    -------
    (r,) maxima, and (r,) positions of the maxima relative to the first member of the run.
    """
    top = np.maximum.reduceat(values, first)
    hits = np.flatnonzero(values == top[run])
    position = np.zeros(len(first), dtype=np.int64)
    # Written backwards, so that the first of equal maxima remains.
    position[run[hits[::-1]]] = hits[::-1]
    return top, position - first


def broadcast_groups(values: Any, group: Group) -> Any:
    """For each row, the value of its group, (m, ...).

    Parameters
    ----------
    values : (groups, ...)
        One value per group. It is returned unchanged if `group` is None.
    group : (m,), optional
        Index of the group of each row; None for a single problem without groups.
    """
    return values if group is None else np.asarray(values)[group]


def take_groups(group: Group, rows: Shaped[np.ndarray, "_"]) -> Int[np.ndarray, "k"] | None:
    """Group indices of selected rows; None for a single problem without groups.

    Parameters
    ----------
    group : (m,), optional
        Index of the group of each row.
    rows : (m,) or (k,)
        Mask or indices of the selected rows.
    """
    return None if group is None else group[rows]


def group_sums(
    values: Float[np.ndarray, "m *k"], group: Group, groups: int
) -> Float[np.ndarray, "*g"]:
    """Sum of the rows of each group.

    Parameters
    ----------
    values : (m, ...)
        The rows.
    group : (m,), optional
        Index of the group of each row; None for a single problem without groups.
    groups : int
        Number of groups.

    Returns
    -------
    (groups, ...), or (...) if `group` is None.
    """
    if group is None:
        return np.asarray(values.sum(axis=0))
    columns = values.reshape(len(values), int(np.prod(values.shape[1:]))).T
    total = np.array([np.bincount(group, column, groups) for column in columns], dtype=np.float64)
    return total.T.reshape(groups, *values.shape[1:])


def group_medians(
    values: Float[np.ndarray, "m"], group: Group, groups: int
) -> Float[np.ndarray, "*g"]:
    """Median of the values of each group; NaN for a group without values.

    Parameters
    ----------
    values : (m,)
        The values.
    group : (m,), optional
        Index of the group of each value; None for a single problem without groups.
    groups : int
        Number of groups.

    Returns
    -------
    (groups,), or a scalar if `group` is None.
    """
    label = np.zeros(len(values), dtype=np.int64) if group is None else group
    count = np.bincount(label, minlength=1 if group is None else groups)
    ordered = np.append(values[np.lexsort((values, label))], np.nan)
    first = np.cumsum(count) - count
    low, high = first + np.maximum(count - 1, 0) // 2, first + count // 2
    median = np.where(
        count > 0, (ordered[low] + ordered[np.minimum(high, len(values))]) / 2, np.nan
    )
    return np.asarray(median[0]) if group is None else median


def point_tree(points_px: Float[np.ndarray, "n 2"]) -> "scipy.spatial.KDTree":
    """k-d tree of points, for few queries.

    Its construction takes half the time of a balanced tree.

    Parameters
    ----------
    points_px : (n, 2)
        The points.
    """
    return scipy.spatial.KDTree(points_px, leafsize=_LEAF, balanced_tree=False, compact_nodes=False)


def near_pairs(
    one_px: Float[np.ndarray, "n 2"],
    other_px: Float[np.ndarray, "m 2"],
    radius_px: float,
    most: int = 8,
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"], Float[np.ndarray, "p"]]:
    """For each first point, the nearest second points within a radius.

    Parameters
    ----------
    one_px, other_px : (n, 2), (m, 2)
        First and second points.
    radius_px : float
        Largest distance.
    most : int
        Largest number of second points for each first point, at least 2.

    Returns
    -------
    (p,) indices of the first points, (p,) indices of the second points, and (p,) distances, px.
    """
    query = point_tree(other_px).query(one_px, k=most, distance_upper_bound=radius_px)
    distance, neighbour = map(np.asarray, query)
    one, slot = np.nonzero(neighbour < len(other_px))
    return one, neighbour[one, slot], distance[one, slot]


def distinct(keys: Int[np.ndarray, "p"]) -> Int[np.ndarray, "d"]:
    """Different values of the keys, in ascending order. Faster than `np.unique`.

    Parameters
    ----------
    keys : (p,)
        Integers that are not negative.
    """
    ordered = np.sort(keys)
    return ordered[np.flatnonzero(np.diff(ordered, prepend=-1))]


def group_labels(
    count: int, one: Int[np.ndarray, "p"], other: Int[np.ndarray, "p"]
) -> Int[np.ndarray, "n"]:
    """Connected component of each item, (n,): the smallest index of an item in this component.

    Parameters
    ----------
    count : int
        Number n of items.
    one, other : (p,), (p,)
        Indices of the two items of each connected pair.
    """
    label = np.arange(count)
    while True:
        lower_label = np.minimum(label[one], label[other])
        # A pair connects the two components, not only its two items.
        for side in (one, other):
            np.minimum.at(label, label[side], lower_label)
        label = label[label]
        if np.array_equal(label[one], label[other]) and np.array_equal(label, label[label]):
            return label
