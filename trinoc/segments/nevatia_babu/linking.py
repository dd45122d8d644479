"""Linking edge points into chains by predecessor and successor."""

import functools

import numpy as np
from jaxtyping import Float, Int

from trinoc.segments.nevatia_babu.thinning import ThinnedPixels

REACH_PX = 2
_SECTORS = 16
# Of the 24 steps, those within some sixty degrees of the direction.
_AHEAD = 10
_LEAST_COSINE = np.float32(np.cos(np.radians(30.0)))


def successors(pixels: ThinnedPixels, shape: tuple[int, int]) -> Int[np.ndarray, "n"]:
    """(n,) the next point along the edge of each point, -1 where there is none.

    Of the points ahead, within two pixels and thirty degrees, the one with the least
    distance along + 1.5 distance across + 2 (1 - cosine of the angle) is preferred; a link
    stands where both sides prefer each other. `shape` is (height, width) of the picture.
    """
    count = len(pixels.pixel)
    successor = np.full(count, -1, dtype=np.int64)
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
    """Every pair (from, to) that may follow each other, and its cost."""
    width = shape[1]
    at_pixel = np.full(shape[0] * width, -1, dtype=np.int32)
    at_pixel[pixels.pixel] = np.arange(len(pixels.pixel), dtype=np.int32)
    # Columns one by one: arrays of pairs would be walked in steps of two.
    along_u, along_v = (np.ascontiguousarray(column) for column in pixels.direction.T)
    u, v = (np.ascontiguousarray(column) for column in pixels.uv_px.T)
    sector = np.rint(np.arctan2(along_v, along_u) * np.float32(_SECTORS / (2 * np.pi)))
    offsets = (_offsets_ahead() @ np.array([1, width]))[sector.astype(np.int64) % _SECTORS]
    found = np.take(at_pixel, pixels.pixel[:, None] + offsets).ravel()
    slot = np.flatnonzero(found >= 0)
    first, second = slot // _AHEAD, found[slot].astype(np.int64)

    one_u, one_v = along_u[first], along_v[first]
    other_u, other_v = along_u[second], along_v[second]
    cosine = one_u * other_u + one_v * other_v
    turning = np.flatnonzero(cosine > _LEAST_COSINE)
    first, second, cosine = first[turning], second[turning], cosine[turning]
    mean_u, mean_v = one_u[turning] + other_u[turning], one_v[turning] + other_v[turning]
    between_u, between_v = u[second] - u[first], v[second] - v[first]
    # Two unit vectors with this cosine add up to a vector of this length.
    size = np.sqrt(2 + 2 * cosine)
    along = (between_u * mean_u + between_v * mean_v) / size
    across = np.abs(between_u * mean_v - between_v * mean_u) / size
    ahead = np.flatnonzero(along > 0)
    cost = along + np.float32(1.5) * across + 2 * (1 - cosine)
    return first[ahead], second[ahead], cost[ahead]


@functools.cache
def _offsets_ahead() -> Int[np.ndarray, "sectors m 2"]:
    """(sectors, m, 2) the (u, v) steps that lie ahead, for each sector of the direction."""
    reach = np.arange(-REACH_PX, REACH_PX + 1)
    steps = np.array([(u, v) for v in reach for u in reach if u or v])
    angle = np.arange(_SECTORS) * (2 * np.pi / _SECTORS)
    ahead = steps @ np.stack([np.cos(angle), np.sin(angle)])
    return np.stack([steps[np.argsort(-column, kind="stable")[:_AHEAD]] for column in ahead.T])
