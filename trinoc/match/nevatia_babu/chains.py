"""From successors to ordered chains, all chains at once."""

import numpy as np
from jaxtyping import Int


def ordered_chains(
    successor: Int[np.ndarray, "n"],
) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "c"]]:
    """(order, starts): the points chain by chain, and where in that order each chain starts.

    Pointer doubling: after k rounds each point knows its 2^k-th predecessor, so that the
    longest chain of the picture needs some twelve rounds and no loop over points. A closed
    chain is opened at its point of lowest index.
    """
    count = len(successor)
    linked = np.flatnonzero(successor >= 0)
    predecessor = np.arange(count)
    predecessor[successor[linked]] = linked
    head, distance, lowest = _heads(predecessor)
    closed = predecessor[head] != head
    if closed.any():
        opened = np.flatnonzero(closed & (lowest == np.arange(count)))
        predecessor[opened] = opened
        head, distance, _ = _heads(predecessor)
    order = np.argsort((head << 32) | distance)
    starts = np.flatnonzero(distance[order] == 0)
    return order, starts


def _heads(predecessor: Int[np.ndarray, "n"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each point: the first point of its chain, the steps to it, the lowest index on the way."""
    count = len(predecessor)
    head = predecessor
    distance = (predecessor != np.arange(count)).astype(np.int64)
    lowest = np.minimum(np.arange(count), predecessor)
    for _ in range(max(1, int(count).bit_length())):
        further = head[head]
        if (further == head).all():
            break
        distance = distance + distance[head]
        lowest = np.minimum(lowest, lowest[head])
        head = further
    return head, distance, lowest
