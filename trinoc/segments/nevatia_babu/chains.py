"""Edge points linked into chains, and chains split into straight runs.

Links are predecessors and successors. Runs come from iterative end-point fit (R. O. Duda and P. E.
Hart, "Pattern classification and scene analysis", 1973, 7.5), as in Nevatia and Babu. All chains
are processed together.
"""

import functools

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.joins import group_maxima, members
from trinoc.segments.nevatia_babu.thinning import BORDER_PX, ThinnedPixels

_SECTORS = 16  # numerical: of the table of steps
# numerical: slopes of the borders of the first sectors, from u toward v.
_SLOPES = np.tan((np.arange(_SECTORS // 4) + 0.5) * (2 * np.pi / _SECTORS)).astype(np.float32)
# Number of the 24 steps within about sixty degrees of the direction.
_AHEAD = 10  # numerical: of the table of steps
# numerical: Nevatia and Babu's own rule.
_LEAST_COSINE = np.float32(np.cos(np.radians(30.0)))
# Points per block, so that the data stay in the processor's cache.
_BLOCK = 1 << 13  # numerical: size of a block


def successors(pixels: ThinnedPixels, shape: tuple[int, int]) -> Int[np.ndarray, "n"]:
    """Return the next point along the edge for each edge point, (n,); -1 if there is none.

    Candidates are points ahead within two pixels, whose direction differs by at most thirty
    degrees. The best candidate has the smallest cost: distance along + 1.5 distance across + 2 (1 -
    cosine of the angle). Two points are linked only if each is the best candidate of the other.
    `shape` is (height, width) of the image.
    """
    count = len(pixels.pixel)
    successor = np.full(count, -1, dtype=np.int64)
    if count == 0:
        return successor
    first, second, cost = _candidate_links(pixels, shape)
    least_before, least_after = (np.full(count, np.inf, dtype=np.float32) for _ in range(2))
    np.minimum.at(least_after, first, cost)
    np.minimum.at(least_before, second, cost)
    mutual = np.flatnonzero((cost == least_after[first]) & (cost == least_before[second]))
    successor[first[mutual]] = second[mutual]
    return successor


def _candidate_links(
    pixels: ThinnedPixels, shape: tuple[int, int]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Return all pairs of points that may be consecutive, as arrays (first, second, cost)."""
    width = shape[1]
    index = np.full(shape[0] * width, -1, dtype=np.int32)
    index[pixels.pixel] = np.arange(len(pixels.pixel), dtype=np.int32)
    # Complex numbers, so that a vector is gathered in one access.
    position = np.ascontiguousarray(pixels.uv_px).view(np.complex64).ravel()
    direction = np.empty_like(position)
    direction.real, direction.imag = -pixels.gradient[:, 1], pixels.gradient[:, 0]
    direction /= pixels.profile[:, 1]
    ahead = _offsets_ahead() @ np.array([1, width])
    parts: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for begin in range(0, len(direction), _BLOCK):
        block = slice(begin, begin + _BLOCK)
        neighbours = np.take(ahead, _sectors(direction[block]), axis=0)
        neighbours += pixels.pixel[block, None]
        neighbour_index = np.take(index, neighbours).ravel()
        slot = np.flatnonzero(neighbour_index >= 0)
        second = np.take(neighbour_index, slot).astype(np.int64)
        parts.append(_links(slot // _AHEAD + begin, second, direction, position))
    first, second, cost = (np.concatenate(part) for part in zip(*parts, strict=True))
    return first, second, cost


def _sectors(direction: np.ndarray) -> Int[np.ndarray, "n"]:
    """Return the sector of each direction, an integer from 0 to _SECTORS - 1, (n,).

    The comparison of slopes is four times faster than an arc tangent.
    """
    u, v = np.abs(np.real(direction)), np.abs(np.imag(direction))
    sector = np.zeros(len(direction), np.int8)
    for slope in _SLOPES:
        sector += v > slope * u
    sector = np.where(np.real(direction) < 0, _SECTORS // 2 - sector, sector)
    return np.where(np.imag(direction) < 0, -sector, sector) & (_SECTORS - 1)


def _links(
    first: Int[np.ndarray, "m"],
    second: Int[np.ndarray, "m"],
    direction: np.ndarray,
    position: np.ndarray,
) -> tuple[Int[np.ndarray, "k"], Int[np.ndarray, "k"], Float[np.ndarray, "k"]]:
    """Select the pairs of nearby points that may be consecutive. Returns (first, second, cost).

    The second point must be ahead of the first, with a similar direction.
    """
    first_direction, second_direction = np.take(direction, first), np.take(direction, second)
    cosine = _dot(first_direction, second_direction)
    turning = np.flatnonzero(cosine > _LEAST_COSINE)
    first, second, cosine = (np.take(values, turning) for values in (first, second, cosine))
    mean = np.take(first_direction, turning) + np.take(second_direction, turning)
    between = np.take(position, second) - np.take(position, first)
    # Length of the sum of two unit vectors with this cosine.
    size = np.sqrt(2 + 2 * cosine)
    along = _dot(between, mean) / size
    across = np.abs(np.real(between) * np.imag(mean) - np.imag(between) * np.real(mean)) / size
    cost = along + np.float32(1.5) * across + 2 * (1 - cosine)
    ahead = np.flatnonzero(along > 0)
    return np.take(first, ahead), np.take(second, ahead), np.take(cost, ahead)


def _dot(a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "m"]:
    """Scalar products of vectors stored as complex numbers."""
    return np.real(a) * np.real(b) + np.imag(a) * np.imag(b)


@functools.cache
def _offsets_ahead() -> Int[np.ndarray, "sectors m 2"]:
    """Return the pixel steps (u, v) that lie ahead, for each sector of the direction, (sectors, m,
    2).
    """
    offsets = np.arange(-BORDER_PX, BORDER_PX + 1)
    steps = np.array([(u, v) for v in offsets for u in offsets if u or v])
    angle = np.arange(_SECTORS) * (2 * np.pi / _SECTORS)
    ahead = steps @ np.stack([np.cos(angle), np.sin(angle)])
    return np.stack([steps[np.argsort(-column, kind="stable")[:_AHEAD]] for column in ahead.T])


def order_chains(
    successor: Int[np.ndarray, "n"], least_points: int = 1
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "c"]]:
    """Sort the points by chain, and along each chain.

    Chains with fewer than `least_points` points are dropped. A closed chain begins at its point
    with the smallest index.

    Parameters
    ----------
    successor : (n,)
        Result of `successors`.
    least_points : int
        Smallest number of points of a chain.

    Returns
    -------
    order : (m,)
        Indices of the points, chain by chain.
    starts : (c,)
        Position in `order` at which each chain begins.

    Notes
    -----
    Pointer doubling: after k rounds, each point stores its 2^k-th predecessor. The longest chain of
    an image therefore needs about twelve rounds, without a loop over points.
    """
    count = len(successor)
    linked = np.flatnonzero(successor >= 0)
    predecessor = np.arange(count)
    predecessor[successor[linked]] = linked
    first_point, distance = _first_points(predecessor)
    closed = np.flatnonzero(predecessor[first_point] != first_point)
    if len(closed):
        lowest = _lowest_of_closed_chains(np.searchsorted(closed, predecessor[closed]))
        predecessor[closed[lowest]] = closed[lowest]
        first_point, distance = _first_points(predecessor)
    length = np.bincount(first_point, minlength=count)
    long_chains = np.flatnonzero(length >= least_points)
    length = length[long_chains]
    starts = np.cumsum(length) - length
    chain_start = np.full(count, -1)
    chain_start[long_chains] = starts
    chain_start = chain_start[first_point]
    within = np.flatnonzero(chain_start >= 0)
    order = np.empty(len(within), dtype=np.int64)
    order[chain_start[within] + distance[within]] = within
    return order, starts


def _lowest_of_closed_chains(predecessor: Int[np.ndarray, "n"]) -> Int[np.ndarray, "k"]:
    """Return the point with the smallest index of each closed chain, (k,).

    All points must lie on closed chains.
    """
    lowest = np.arange(len(predecessor))
    for _ in range(len(predecessor).bit_length()):
        lowest = np.minimum(lowest, lowest[predecessor])
        predecessor = predecessor[predecessor]
    return np.flatnonzero(lowest == np.arange(len(lowest)))


def _first_points(predecessor: Int[np.ndarray, "n"]) -> tuple[np.ndarray, np.ndarray]:
    """Return the first point of each point's chain, and the number of steps to it, (n,) each.

    For a closed chain, any of its points is returned.
    """
    count = len(predecessor)
    first_point = predecessor.copy()
    distance = (predecessor != np.arange(count)).astype(np.int64)
    # Points whose first point is final need no more rounds; most chains are short.
    under_way = np.flatnonzero(predecessor[predecessor] != predecessor)
    for _ in range(max(1, int(count).bit_length())):
        if len(under_way) == 0:
            break
        before = first_point[under_way]
        further, steps = first_point[before], distance[before]
        first_point[under_way] = further
        distance[under_way] += steps
        under_way = under_way[first_point[further] != further]
    return first_point, distance


def split_chains(
    uv_px: Float[np.ndarray, "n 2"],
    starts: Int[np.ndarray, "c"],
    tolerance_px: float,
    least_points: int,
) -> tuple[Int[np.ndarray, "r"], Int[np.ndarray, "r"]]:
    """Split chains into straight runs, and return the (start, stop) positions of each run.

    All points of a run are within `tolerance_px` of the chord between its ends. `uv_px` are the
    points chain by chain, `starts` the first point of each chain. Runs with fewer than
    `least_points` points are dropped.
    """
    start, stop = starts, np.append(starts[1:], len(uv_px))
    u, v = (np.ascontiguousarray(column) for column in uv_px.T)
    done: list[tuple[np.ndarray, np.ndarray]] = []
    while True:
        long_enough = stop - start >= least_points
        start, stop = start[long_enough], stop[long_enough]
        if len(start) == 0:
            break
        index, run, first = members(start, stop)
        begin_u, begin_v = u[start], v[start]
        chord_u, chord_v = u[stop - 1] - begin_u, v[stop - 1] - begin_v
        length = np.maximum(np.hypot(chord_u, chord_v), np.float32(1e-9))
        normal_u, normal_v = -chord_v / length, chord_u / length
        from_begin = normal_u * begin_u + normal_v * begin_v
        distance = np.take(u, index) * np.take(normal_u, run)
        distance += np.take(v, index) * np.take(normal_v, run)
        distance = np.abs(distance - np.take(from_begin, run))
        deviation, position = group_maxima(distance, first, run)
        straight = deviation <= tolerance_px
        done.append((start[straight], stop[straight]))
        bent = ~straight
        middle = start[bent] + np.clip(position[bent], 1, stop[bent] - start[bent] - 2)
        start, stop = (
            np.concatenate([start[bent], middle]),
            np.concatenate([middle + 1, stop[bent]]),
        )
    if not done:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    start, stop = (np.concatenate(parts) for parts in zip(*done, strict=True))
    order = np.argsort(start, kind="stable")
    return start[order], stop[order]
