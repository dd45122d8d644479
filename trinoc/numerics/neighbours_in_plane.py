"""Points near points, and the groups that pairs tie together."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

_MOST_NEIGHBOURS = 8
# Points of a leaf: the fastest, to build and to ask, for some thousands of points.
_LEAF = 16


def point_tree(points_px: Float[np.ndarray, "n 2"]) -> KDTree:
    """A tree for few questions: built in half the time that a balanced one takes."""
    return KDTree(points_px, leafsize=_LEAF, balanced_tree=False, compact_nodes=False)


def near_pairs(
    one_px: Float[np.ndarray, "n 2"], other_px: Float[np.ndarray, "m 2"], radius_px: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"], Float[np.ndarray, "p"]]:
    """(i, j, distance): of each of the first points, the nearest of the others within the radius.

    At most eight per point are given.
    """
    most = min(_MOST_NEIGHBOURS, len(other_px))
    distance, found = point_tree(other_px).query(one_px, k=most, distance_upper_bound=radius_px)
    # With k = 1 the second axis is dropped.
    shape = (len(one_px), most)
    distance, found = np.reshape(distance, shape), np.reshape(found, shape)
    one, slot = np.nonzero(found < len(other_px))
    return one, found[one, slot], distance[one, slot]


def distinct(keys: Int[np.ndarray, "p"]) -> Int[np.ndarray, "d"]:
    """The different keys in rising order; none may be negative. Faster than np.unique."""
    ordered = np.sort(keys)
    return ordered[np.flatnonzero(np.diff(ordered, prepend=-1))]


def group_labels(
    count: int, one: Int[np.ndarray, "p"], other: Int[np.ndarray, "p"]
) -> Int[np.ndarray, "n"]:
    """(n,) a label per item, equal for items that pairs tie together, directly or not."""
    label = np.arange(count)
    while True:
        lowest = np.minimum(label[one], label[other])
        lower = label.copy()
        np.minimum.at(lower, one, lowest)
        np.minimum.at(lower, other, lowest)
        lower = lower[lower]
        if np.array_equal(lower, label):
            return label
        label = lower
