"""Linking edge points into chains by predecessor and successor."""

import functools

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.nevatia_babu.thinning import ThinnedPixels

REACH_PX = 2
_SECTORS = 16
# Of the 24 steps, those within some sixty degrees of the direction.
_AHEAD = 10
_LEAST_COSINE = np.cos(np.radians(30.0))


def successors(pixels: ThinnedPixels, shape: tuple[int, int]) -> Int[np.ndarray, "n"]:
    """(n,) the next point along the edge of each point, -1 where there is none.

    Of the points ahead, within two pixels and thirty degrees, the one with the least
    distance along + 1.5 distance across + 2 (1 - cosine of the angle) is preferred; a link
    stands where both sides prefer each other. `shape` is (height, width) of the picture.
    """
    count = len(pixels.pixel)
    successor = np.full(count, -1, dtype=np.int64)
    first, second, cost = _candidate_links(pixels, shape)
    if len(first) == 0:
        return successor
    chosen = _first_of_each(first, cost)
    chosen = chosen[_is_first_of_each(second, cost)[chosen]]
    successor[first[chosen]] = second[chosen]
    return successor


def _candidate_links(
    pixels: ThinnedPixels, shape: tuple[int, int]
) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"], Float[np.ndarray, "m"]]:
    """Every pair (from, to) that may follow each other, and its cost."""
    width = shape[1]
    at_pixel = np.full(shape[0] * width, -1, dtype=np.int32)
    at_pixel[pixels.pixel] = np.arange(len(pixels.pixel), dtype=np.int32)
    direction = pixels.direction
    sector = np.rint(
        np.arctan2(direction[:, 1], direction[:, 0]) * (_SECTORS / (2 * np.pi))
    ).astype(np.int64)
    offsets = _offsets_ahead()
    neighbours = pixels.pixel[:, None] + (offsets @ np.array([1, width]))[sector % _SECTORS]
    found = at_pixel[neighbours]
    first, which = np.nonzero(found >= 0)
    second = found[first, which].astype(np.int64)

    between = pixels.uv_px[second] - pixels.uv_px[first]
    one, other = direction[first], direction[second]
    cosine = (one * other).sum(axis=-1)
    mean = one + other
    mean /= np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-6)
    along = (between * mean).sum(axis=-1)
    across = np.abs(between[:, 0] * mean[:, 1] - between[:, 1] * mean[:, 0])
    allowed = (cosine > _LEAST_COSINE) & (along > 0)
    cost = along + 1.5 * across + 2 * (1 - cosine)
    return first[allowed], second[allowed], cost[allowed]


@functools.cache
def _offsets_ahead() -> Int[np.ndarray, "sectors m 2"]:
    """(sectors, m, 2) the (u, v) steps that lie ahead, for each sector of the direction."""
    reach = np.arange(-REACH_PX, REACH_PX + 1)
    steps = np.array([(u, v) for v in reach for u in reach if u or v])
    angle = np.arange(_SECTORS) * (2 * np.pi / _SECTORS)
    ahead = steps @ np.stack([np.cos(angle), np.sin(angle)])
    return np.stack([steps[np.argsort(-column, kind="stable")[:_AHEAD]] for column in ahead.T])


def _first_of_each(group: Int[np.ndarray, "m"], cost: Float[np.ndarray, "m"]) -> np.ndarray:
    """Indices of the cheapest member of each group."""
    order = np.argsort(_rank_key(group, cost))
    grouped = group[order]
    return order[np.concatenate([[True], grouped[1:] != grouped[:-1]])]


def _is_first_of_each(group: Int[np.ndarray, "m"], cost: Float[np.ndarray, "m"]) -> np.ndarray:
    mark = np.zeros(len(group), dtype=bool)
    mark[_first_of_each(group, cost)] = True
    return mark


def _rank_key(group: Int[np.ndarray, "m"], cost: Float[np.ndarray, "m"]) -> Int[np.ndarray, "m"]:
    """Whole numbers that sort by group, then by cost in steps of 1e-4."""
    return (group << 20) | np.rint(cost * 1e4).astype(np.int64)
