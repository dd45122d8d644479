"""Which pixels belong to the surroundings of one segment alone."""

import numpy as np
from jaxtyping import Bool, Float, Int

NOBODY = -1


def owners_of(
    ends_px: Float[np.ndarray, "n 2 2"], size_px: tuple[int, int], reach_px: float
) -> tuple[Int[np.ndarray, "h w"], Int[np.ndarray, "h w"]]:
    """The first and the last of the segments within reach of each pixel, NOBODY without any.

    Where they are the same, the pixel is near that segment alone.
    """
    width, height = size_px
    first = np.full((height, width), len(ends_px), dtype=np.int64)
    last = np.full((height, width), NOBODY, dtype=np.int64)
    for number, ends in enumerate(ends_px):
        low = np.clip(np.floor(ends.min(axis=0) - reach_px), 0, None).astype(np.int64)
        high = np.ceil(ends.max(axis=0) + reach_px).astype(np.int64) + 1
        rows, columns = slice(low[1], max(high[1], 0)), slice(low[0], max(high[0], 0))
        near = _within(ends, first[rows, columns].shape, low, reach_px)
        first[rows, columns][near] = np.minimum(first[rows, columns][near], number)
        last[rows, columns][near] = number
    return np.where(last == NOBODY, NOBODY, first), last


def _within(
    ends: Float[np.ndarray, "2 2"],
    shape: tuple[int, ...],
    origin: Int[np.ndarray, "2"],
    reach_px: float,
) -> Bool[np.ndarray, "_ _"]:
    way = ends[1] - ends[0]
    length = np.linalg.norm(way)
    way = way / max(length, 1e-9)
    v, u = np.ogrid[: shape[0], : shape[1]]
    off_u, off_v = u + origin[0] - ends[0, 0], v + origin[1] - ends[0, 1]
    along, across = off_u * way[0] + off_v * way[1], off_v * way[0] - off_u * way[1]
    beside = (along > -reach_px) & (along < length + reach_px)
    return np.asarray(beside & (np.abs(across) < reach_px))
