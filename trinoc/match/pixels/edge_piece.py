"""From where to where an edge goes along a probe, and where across it lies."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import height_of_step, log_parabola
from trinoc.match.pixels.probes import BLOCKS, SHOULDER
from trinoc.match.tuning.every_group import DEFAULT

# numerical: guards: least bend of the logarithm of a ridge; least weight of a block; least height
# of a ridge, grey levels per px, and of what is beside it, as a share of it.
_LEAST_BEND, _LEAST_WEIGHT, _LEAST_TOP, _LEAST_SHARE = 0.05, 1e-3, 1e-3, 0.05


class Extent(NamedTuple):
    """first, last : (n,) blocks, last excluded. sigma : (n, 2) of these, in blocks."""

    first: Int[np.ndarray, "n"]
    last: Int[np.ndarray, "n"]
    sigma: Float[np.ndarray, "n 2"]


class Place(NamedTuple):
    """Fields
    ------
    middle : (n, 2) of the first and the second half, in blocks along the probe.
    offset_px, variance_px2 : (n, 2) across at these, the variance from noise, from what is not
        straight, and from other edges, which make the two shoulders differ.
    width_px : (n, 2) standard deviation there of the ridge, as a Gaussian, across the edge.
    contrast : (n,) grey levels of the step.
    """

    middle: Float[np.ndarray, "n 2"]
    offset_px: Float[np.ndarray, "n 2"]
    variance_px2: Float[np.ndarray, "n 2"]
    width_px: Float[np.ndarray, "n 2"]
    contrast: Float[np.ndarray, "n"]


def estimate_extent(
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
    gain = np.where(usable, gain, -np.inf)
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


def locate_edge(
    across: Float[np.ndarray, "n o b"],
    at_px: Int[np.ndarray, "n"],
    extent: Extent,
    variance: Float[np.ndarray, "n"],
) -> Place:
    """Where the edge lies in either half, by a log-parabola about its line, which is at `at_px`;
    `variance` is that of one block in the sum of many."""
    beside = np.array([-SHOULDER, -1, 0, 1, SHOULDER])
    column = (at_px + across.shape[1] // 2)[:, None] + beside
    near = np.take_along_axis(across, column[..., None], axis=1)
    halves = _halves(extent)
    inside = halves.max(axis=1)
    top = np.maximum((near[:, 2] * inside).sum(axis=1) / inside.sum(axis=1), _LEAST_TOP)
    alone = _alone(near, top, np.sqrt(2 * variance))
    profile = (near @ (inside * alone)[..., None])[..., 0] / (inside * alone).sum(axis=1)[:, None]
    top = np.maximum(profile[:, 2], _LEAST_TOP)
    _, bend = _parabola(profile, top)
    # The difference of two places, 2 px apart, has about the ridge's own variance.
    of_block = variance / (2 * bend * top) ** 2
    weight = halves * alone[:, None]
    middle, offset = _middles(weight, extent), _offsets(weight, near, at_px, bend, top)
    means = weight @ near.mT / weight.sum(axis=2, keepdims=True)
    own = of_block[:, None] * (weight**2).sum(axis=2) / weight.sum(axis=2) ** 2
    quarters = _quarters(halves) * alone[:, None]
    apart = _offsets(quarters, near, at_px, bend, top) - _on_line(quarters, middle, offset)
    noise = (
        of_block[:, None] * (quarters**2).sum(axis=2) / np.maximum(quarters.sum(axis=2), 1e-9) ** 2
    )
    # Noise alone is not straight either: what exceeds three of its variances is a bend.
    bow = np.where(quarters.sum(axis=2) > 0, np.maximum(apart**2 - 3 * noise, 0.0), 0.0).mean(
        axis=1
    )
    pull = DEFAULT.guided.pull_px * (means[..., 4] - means[..., 0]) / top[:, None]
    own += bow[:, None] + pull**2 + DEFAULT.guided.floor_px**2
    width = 1 / np.sqrt(_parabola(means, np.maximum(means[..., 2], _LEAST_TOP))[1])
    return Place(middle, offset, own, width, height_of_step(top, 1 / bend))


def _parabola(
    profile: Float[np.ndarray, "*n p"], top: Float[np.ndarray, "*n"]
) -> tuple[Float[np.ndarray, "*n"], Float[np.ndarray, "*n"]]:
    """(rise, bend) of the logarithm of a ridge, about its middle."""
    rise, bend = log_parabola(profile[..., 1:4], _LEAST_SHARE * top[..., None])
    return rise, np.maximum(bend, _LEAST_BEND)


def _offsets(
    weight: Float[np.ndarray, "n k b"],
    near: Float[np.ndarray, "n p b"],
    at_px: Int[np.ndarray, "n"],
    bend: Float[np.ndarray, "n"],
    top: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n k"]:
    """Where the edge lies across in each part, by the parabola of all."""
    total = np.maximum(weight.sum(axis=2), 1e-9)
    means = (weight @ near.mT) / total[..., None]
    rise, _ = _parabola(means, np.broadcast_to(top[:, None], total.shape))
    # The parabola is that of places up to 1 px away.
    return at_px[:, None] + np.clip(rise / bend[:, None], -1.0, 1.0)


def _on_line(
    weight: Float[np.ndarray, "n k b"],
    middle: Float[np.ndarray, "n 2"],
    offset: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n k"]:
    """Where the line through the middles of both halves lies across, at the middles of parts."""
    place = weight @ (np.arange(BLOCKS) + 0.5) / np.maximum(weight.sum(axis=2), 1e-9)
    slope = (offset[:, 1] - offset[:, 0]) / (middle[:, 1] - middle[:, 0])
    return offset[:, :1] + slope[:, None] * (place - middle[:, :1])


def _quarters(halves: Float[np.ndarray, "n 2 b"]) -> Float[np.ndarray, "n 4 b"]:
    """The first and the second part of both halves."""
    number = np.cumsum(halves, axis=2)
    first = halves * (number <= (halves.sum(axis=2, keepdims=True) + 1) // 2)
    return np.concatenate([first, halves - first], axis=1)


def _halves(extent: Extent) -> Float[np.ndarray, "n 2 b"]:
    """1 on the blocks of the first and of the second half; both are the block of a single one."""
    blocks, first, last = np.arange(BLOCKS), extent.first[:, None], extent.last[:, None]
    split = first + (np.maximum(last - first, 1) + 1) // 2
    left = (blocks >= first) & (blocks < split)
    right = (blocks >= np.minimum(split, last - 1)) & (blocks < last)
    return np.stack([left, right], axis=1).astype(np.float64)


def _alone(
    near: Float[np.ndarray, "n p b"], top: Float[np.ndarray, "n"], noise: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n b"]:
    """Weight of each block, 1 where both shoulders are alike: no other edge is beside it."""
    unlike = np.abs(near[:, -1] - near[:, 0]) - 2 * noise[:, None]
    excess = np.maximum(unlike / top[:, None] - DEFAULT.guided.unlike_share, 0.0)
    return np.maximum(1 / (1 + (excess / DEFAULT.guided.unlike_share) ** 2), _LEAST_WEIGHT)


def _middles(weight: Float[np.ndarray, "n 2 b"], extent: Extent) -> Float[np.ndarray, "n 2"]:
    """Where the halves lie along the probe, in blocks; those of one block, at its quarters."""
    middle = weight @ (np.arange(BLOCKS) + 0.5) / weight.sum(axis=2)
    one = (extent.last - extent.first == 1)[:, None]
    return middle + np.where(one, np.array([-0.25, 0.25]), 0.0)
