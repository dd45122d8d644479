"""From where to where an edge goes along a probe, and where across it lies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.probes import BLOCKS
from trinoc.match.guided.ridges import SHOULDER

# What one block may say for or against an edge that goes on, log likelihood.
_MOST_OF_BLOCK = 4.0
# Most that the ridge of either half may lie off its line, px, and least bend of its logarithm.
_MOST_SHIFT, _LEAST_BEND = 1.5, 0.05


class Extent(NamedTuple):
    """first, last : (n,) blocks, last excluded. sigma : (n, 2) of these, in blocks."""

    first: Int[np.ndarray, "n"]
    last: Int[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n 2"]


class Place(NamedTuple):
    """Fields
    ------
    offset_px, variance_px2 : (n, 2) across, of the first and the second half, from noise.
    contrast : (n,) grey levels of the step.
    asymmetry : (n,) how far its two shoulders differ, as a share of its height.
    """

    offset_px: Float[np.ndarray, "n 2"]
    variance_px2: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]
    asymmetry: Float[np.ndarray, "n"]


def extent_of(
    own: Float[np.ndarray, "n b"],
    mean: Float[np.ndarray, "n"],
    usable: Bool[np.ndarray, "n b"],
    half: Int[np.ndarray, "n"],
    growth: float,
) -> Extent:
    """From where to where the edge goes on at the height of its window, by likelihood.

    `half` is the middle of the window: ends may move inward as well, since the first and last
    blocks of a window may hold no edge.
    """
    gain = (own * mean[:, None] - 0.5 * mean[:, None] ** 2) / growth
    gain = np.where(usable, np.clip(gain, -_MOST_OF_BLOCK, _MOST_OF_BLOCK), -4 * _MOST_OF_BLOCK)
    blocks, cuts = np.arange(BLOCKS), np.arange(BLOCKS + 1)
    right = np.where(blocks >= half[:, None], gain, 0.0)
    left = np.where(blocks < half[:, None], gain, 0.0)
    # Cut k: the edge goes on up to block k, excluded, or from block k on.
    zero = np.zeros((len(own), 1))
    up_to = np.concatenate([zero, np.cumsum(right, axis=1)], axis=1)
    from_on = np.concatenate([np.cumsum(left[:, ::-1], axis=1)[:, ::-1], zero], axis=1)
    up_to = np.where(cuts > half[:, None], up_to, -np.inf)
    from_on = np.where(cuts <= half[:, None], from_on, -np.inf)
    sigma = np.stack([_spread(from_on), _spread(up_to)], axis=1)
    return Extent(from_on.argmax(axis=1), up_to.argmax(axis=1), sigma)


def _spread(log: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "n"]:
    """Standard deviation of a cut with these log likelihoods, which lies anywhere in its block."""
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    places = np.arange(log.shape[1])
    middle = weight @ places
    return np.sqrt((weight * (places - middle[:, None]) ** 2).sum(axis=1) + 1 / 12)


def placed(
    across: Float[np.ndarray, "n o b"],
    column: Int[np.ndarray, "n b"],
    at: Int[np.ndarray, "n b"],
    extent: Extent,
    variance: Float[np.ndarray, "n"],
) -> Place:
    """Where the edge lies in either half, by a log-parabola; `column` and `at` are where its line
    is at every block, `variance` is that of one block in the sum of many."""
    blocks = np.arange(BLOCKS)
    first, last = extent.first[:, None], extent.last[:, None]
    split = first + (np.maximum(last - first, 1) + 1) // 2
    halves = [(blocks >= first) & (blocks < split), (blocks >= split) & (blocks < last)]
    halves = np.stack(halves, axis=1).astype(np.float64)
    number = np.maximum(halves.sum(axis=2), 1.0)
    beside = np.array([-SHOULDER, -1, 0, 1, SHOULDER])[:, None]
    near = np.take_along_axis(across, column[:, None] + beside, axis=1)
    means = (halves @ near.mT) / number[..., None]
    whole = (means * number[..., None]).sum(axis=1) / number.sum(axis=1)[:, None]
    top = np.maximum(whole[:, 2], 1e-3)
    log = np.log(np.maximum(whole[:, 1:4], 0.05 * top[:, None]))
    bend = np.maximum(2 * log[:, 1] - log[:, 0] - log[:, 2], _LEAST_BEND)
    log = np.log(np.maximum(means[..., 1:4], 0.05 * top[:, None, None]))
    shift = (log[..., 2] - log[..., 0]) / (2 * bend[:, None])
    where = (halves @ at[..., None])[..., 0] / number + np.clip(shift, -_MOST_SHIFT, _MOST_SHIFT)
    # The difference of two places, 2 px apart, has about the ridge's own variance.
    scale = variance / (2 * bend * top) ** 2
    contrast = top * np.sqrt(2 * np.pi / bend)
    return Place(where, scale[:, None] / number, contrast, (whole[:, 4] - whole[:, 0]) / top)
