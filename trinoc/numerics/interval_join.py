"""Joins and groups on sorted arrays: the index work of the matcher, never all against all."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int


def expand_ranges(
    start: Int[np.ndarray, "n"], stop: Int[np.ndarray, "n"]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """(owner, position): every position of range(start[i], stop[i]), with its i."""
    count = np.maximum(stop - start, 0)
    owner = np.repeat(np.arange(len(start)), count)
    offset = np.repeat(start - np.concatenate([[0], np.cumsum(count)[:-1]]), count)
    return owner, np.arange(len(owner)) + offset


def overlapping(
    first: Float[np.ndarray, "n 2"], second: Float[np.ndarray, "m 2"]
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """(i, j) of all pairs of intervals (low, high) that overlap, each pair once.

    Of two intervals that overlap, exactly one starts inside the other: a search in the sorted
    starts finds the pairs without looking at any other.
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
    first: Float[np.ndarray, "n 2"], second: Float[np.ndarray, "m 2"], at_once: int
) -> Iterator[slice]:
    """Slices of `first` of which about `at_once` pairs overlap, and more only of a single one; one
    empty slice for none."""
    begun = np.searchsorted(np.sort(second[:, 0]), first[:, 1], "left")
    over = np.searchsorted(np.sort(second[:, 1]), first[:, 0], "right")
    before = np.cumsum(begun - over)
    borders = np.searchsorted(before, np.arange(at_once, before[-1] if len(before) else 0, at_once))
    if len(first) == 0:
        yield slice(0, 0)
    for start, stop in pairwise(np.unique([0, *borders, len(first)]).tolist()):
        yield slice(start, stop)


def pairs_of_equal_keys(
    keys: Int[np.ndarray, "n"], at_once: int = 1 << 21
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """(m, n) with m and n any two different positions that hold one key, each pair once.

    In blocks of about `at_once` pairs, so that their number is no matter of memory.
    """
    order = np.argsort(keys, kind="stable")
    ordered = keys[order]
    first = np.searchsorted(ordered, ordered, "left")
    before = np.cumsum(np.arange(len(ordered)) - first)
    borders = np.searchsorted(before, np.arange(0, before[-1] if len(before) else 0, at_once))
    for start, stop in pairwise([*np.unique(borders).tolist(), len(ordered)]):
        rows = np.arange(start, stop)
        later, earlier = expand_ranges(first[rows], rows)
        yield order[earlier], order[start + later]
