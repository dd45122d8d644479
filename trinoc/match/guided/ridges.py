"""The ridge that an edge makes of the gradient along a probe, summed over windows of blocks.

An edge is what stands above the mean of the gradient SHOULDER px to both sides, so that shading,
however steep, is none. Of white or coloured noise the sum of n blocks has the variance
n sigma^2 g(n), with sigma of the probe itself and g of the picture (`false_alarms.py`).
"""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.image import levels_between
from trinoc.match.guided.gradient import SMOOTHING_PX
from trinoc.match.guided.probes import BLOCKS, STEP_PX, Samples
from trinoc.numerics import MAD_TO_SIGMA

SHOULDER = 3
REACH = 2
# Places across, px.
OFFSETS = np.arange(-REACH - SHOULDER, REACH + SHOULDER + 1)
# Blocks of a window; one begins half a window after the other.
WINDOWS = (2, 4, 8, 16, 32)
_BEGIN = [np.arange(0, BLOCKS - size + 1, max(size // 2, 1)) for size in WINDOWS]
WINDOW_FIRST = np.concatenate(_BEGIN)
_WINDOW_KIND = np.repeat(np.arange(len(WINDOWS)), [len(begin) for begin in _BEGIN])
WINDOW_SIZE = np.array(WINDOWS)[_WINDOW_KIND]
WINDOW_LAST = WINDOW_FIRST + WINDOW_SIZE - 1
_BLOCK = np.arange(BLOCKS)[:, None]
_IN_WINDOW = ((_BLOCK >= WINDOW_FIRST) & (_BLOCK <= WINDOW_LAST)).astype(np.float32)
# What white noise has in common in a block and the next, and the one after that.
_ONE, _TWO, _THREE = (np.exp(-((k * STEP_PX / SMOOTHING_PX) ** 2) / 4) for k in (1, 2, 3))
NEXT = float((_ONE + 2 * _TWO + _THREE) / (2 + 2 * _ONE))
SECOND = float((_THREE) / (2 + 2 * _ONE))


def block_gradients(
    by_uv: Float[np.ndarray, "2 h w"], places: Samples
) -> tuple[Float[np.ndarray, "n o b"], Float[np.ndarray, "n o b"], Bool[np.ndarray, "n b"]]:
    """(gradient across and along at OFFSETS, means of each block's two places; whether both are
    inside)."""
    by_u, by_v = (
        0.5 * (found[..., ::2] + found[..., 1::2])
        for found in (levels_between(of, places.uv_px, places.normal, OFFSETS) for of in by_uv)
    )
    normal_u, normal_v = (places.normal[:, None, ::2, k] for k in (0, 1))
    known = places.inside[:, ::2] & places.inside[:, 1::2]
    return by_u * normal_u + by_v * normal_v, by_u * normal_v - by_v * normal_u, known


def ridge(across: Float[np.ndarray, "n o b"]) -> Float[np.ndarray, "n r b"]:
    """The gradient at offsets up to REACH above the mean of that on both sides."""
    inner = across[:, SHOULDER:-SHOULDER]
    return inner - 0.5 * (across[:, : -2 * SHOULDER] + across[:, 2 * SHOULDER :])


def ridge_sigma(
    height: Float[np.ndarray, "n r b"], known: Bool[np.ndarray, "n b"], least: float
) -> Float[np.ndarray, "n"]:
    """Standard deviation of one block's ridge about what is common along the probe; at least
    `least`, that of the picture's noise."""
    # Second differences: neither what is common nor what changes evenly counts, such as an edge
    # that comes nearer.
    change = np.abs(height[..., 2:] - 2 * height[..., 1:-1] + height[..., :-2])
    held = known[:, 2:] & known[:, 1:-1] & known[:, :-2]
    change[np.broadcast_to(~held[:, None], change.shape)] = np.inf
    in_order = np.sort(change.reshape(len(height), -1), axis=1)
    count = held.sum(axis=1) * height.shape[1]
    middle = np.stack([np.maximum(count - 1, 0) // 2, count // 2], axis=1)
    middle = np.take_along_axis(in_order, middle, axis=1).mean(axis=1)
    gain = MAD_TO_SIGMA / np.sqrt(6 - 8 * NEXT + 2 * SECOND)
    return np.maximum(np.where(count > 0, gain * middle, 0.0), least).astype(height.dtype)


def windows(values: Float[np.ndarray, "*l b"]) -> Float[np.ndarray, "*l x"]:
    """Sums over all windows."""
    return values @ _IN_WINDOW


def whole_windows(inside: Bool[np.ndarray, "*l b"]) -> Bool[np.ndarray, "*l x"]:
    """Whether all blocks of each window are inside."""
    return windows((~inside).astype(np.float32)) < 0.5


def window_spread(growth: Float[np.ndarray, "k"]) -> Float[np.ndarray, "x"]:
    """Standard deviation of every window's sum, in those of one block."""
    return np.sqrt(WINDOW_SIZE * growth[_WINDOW_KIND]).astype(np.float32)


def window_scores(
    by_uv: Float[np.ndarray, "2 h w"], least: float, places: Samples
) -> tuple[Float[np.ndarray, "n x"], Bool[np.ndarray, "n x"]]:
    """(sums of ridge, over sigma and the root of blocks, of every window on each probe itself;
    whether all of it is inside)."""
    across, _, known = block_gradients(by_uv, places)
    height = ridge(across)
    sigma = ridge_sigma(height, known, least)
    alone = window_spread(np.ones(len(WINDOWS)))
    return windows(height[:, REACH]) / sigma[:, None] / alone, whole_windows(known)
