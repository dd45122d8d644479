"""From successors to ordered chains, all chains at once."""

import numpy as np
from jaxtyping import Int


def ordered_chains(
    successor: Int[np.ndarray, "n"], least_points: int = 1
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "c"]]:
    """(order, starts): the points chain by chain, and where in that order each chain starts.

    Pointer doubling: after k rounds each point knows its 2^k-th predecessor, so that the
    longest chain of the picture needs some twelve rounds and no loop over points. A closed
    chain is opened at its point of lowest index. Chains of fewer than `least_points` points are
    left out.
    """
    count = len(successor)
    linked = np.flatnonzero(successor >= 0)
    predecessor = np.arange(count)
    predecessor[successor[linked]] = linked
    head, distance = _heads(predecessor)
    closed = np.flatnonzero(predecessor[head] != head)
    if len(closed):
        predecessor[_lowest_of_loops(predecessor, closed)] = -1
        opened = np.flatnonzero(predecessor < 0)
        predecessor[opened] = opened
        # Only theirs: others are none of their points.
        place = np.empty(count, dtype=np.int64)
        place[closed] = np.arange(len(closed))
        of_closed, distance[closed] = _heads(place[predecessor[closed]])
        head[closed] = closed[of_closed]
    length = np.bincount(head, minlength=count)
    kept = np.flatnonzero(length >= least_points)
    length = length[kept]
    starts = np.cumsum(length) - length
    place = np.full(count, -1)
    place[kept] = starts
    place = place[head]
    within = np.flatnonzero(place >= 0)
    order = np.empty(len(within), dtype=np.int64)
    order[place[within] + distance[within]] = within
    return order, starts


def _heads(predecessor: Int[np.ndarray, "n"]) -> tuple[np.ndarray, np.ndarray]:
    """Of each point: the first point of its chain, and the steps to it.

    Points of a closed chain have no first point: some other point of the chain stands there.
    """
    count = len(predecessor)
    head = predecessor.copy()
    distance = (predecessor != np.arange(count)).astype(np.int64)
    # Points that know the first of their chain are done; most chains are short.
    under_way = np.flatnonzero(predecessor[predecessor] != predecessor)
    for _ in range(max(1, int(count).bit_length())):
        if len(under_way) == 0:
            break
        before = head[under_way]
        further, steps = head[before], distance[before]
        head[under_way] = further
        distance[under_way] += steps
        under_way = under_way[head[further] != further]
    return head, distance


def _lowest_of_loops(
    predecessor: Int[np.ndarray, "n"], closed: Int[np.ndarray, "m"]
) -> Int[np.ndarray, "loops"]:
    """The point of lowest index of each closed chain; `closed` are all points of such chains."""
    place = np.empty(len(predecessor), dtype=np.int64)
    here = np.arange(len(closed))
    place[closed] = here
    back, lowest = place[predecessor[closed]], here
    # After k rounds each point knows the lowest of the 2^k points before it.
    for _ in range(len(closed).bit_length()):
        lowest = np.minimum(lowest, lowest[back])
        back = back[back]
    return closed[lowest == here]
