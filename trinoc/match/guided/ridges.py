"""The ridge that an edge makes of the gradient along a probe, summed over windows of blocks.

An edge is what stands above the mean of the gradient SHOULDER px to both sides, so that shading,
however steep, is none. Of white or coloured noise the sum of n blocks has the variance
n sigma^2 g(n), with sigma of the probe itself and g of the picture (`false_alarms.py`).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.guided.gradient import SMOOTHING_PX
from trinoc.match.guided.probes import BLOCKS, STEP_PX
from trinoc.numerics import ArrayLike

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
_BLOCK = np.arange(BLOCKS)[:, None]
_IN_WINDOW = (_BLOCK >= WINDOW_FIRST) & (_BLOCK < WINDOW_FIRST + WINDOW_SIZE)
_MAD = 1.4826
# What white noise has in common in a block and the next, and the one after that.
_ONE, _TWO, _THREE = (np.exp(-((k * STEP_PX / SMOOTHING_PX) ** 2) / 4) for k in (1, 2, 3))
NEXT = float((_ONE + 2 * _TWO + _THREE) / (2 + 2 * _ONE))
SECOND = float((_THREE) / (2 + 2 * _ONE))


def block_gradients(
    gradient: Float[ArrayLike, "h w 2"],
    uv_px: Float[ArrayLike, "s 2"],
    normal: Float[ArrayLike, "s 2"],
    inside: Bool[ArrayLike, "s"],
) -> tuple[Float[ArrayLike, "b o"], Float[ArrayLike, "b o"], Bool[ArrayLike, "b"]]:
    """(gradient across and along at OFFSETS, means of each block's two places; whether both are
    inside)."""
    offset = jnp.asarray(OFFSETS, dtype=gradient.dtype)
    places = uv_px[:, None] + offset[None, :, None] * normal[:, None]
    height, width, _ = gradient.shape
    most = jnp.array([[[width - 2, height - 2]]], gradient.dtype)
    low = jnp.clip(jnp.floor(places), 0, most)
    share = jnp.clip(places - low, 0, 1)
    u, v = (low[..., k].astype(jnp.int32) for k in (0, 1))
    flat = jnp.asarray(gradient).reshape(-1, 2)
    start = v * width + u
    a, b = share[..., :1], share[..., 1:]
    value = (
        flat[start] * (1 - a) * (1 - b)
        + flat[start + 1] * a * (1 - b)
        + flat[start + width] * (1 - a) * b
        + flat[start + width + 1] * a * b
    )
    n = normal[:, None]
    across = value[..., 0] * n[..., 0] + value[..., 1] * n[..., 1]
    along = value[..., 0] * n[..., 1] - value[..., 1] * n[..., 0]
    across, along = (x.reshape(BLOCKS, 2, -1).mean(axis=1) for x in (across, along))
    return across, along, jnp.asarray(inside).reshape(BLOCKS, 2).all(axis=1)


def ridge(across: Float[ArrayLike, "b o"]) -> Float[ArrayLike, "b r"]:
    """The gradient at offsets up to REACH above the mean of that on both sides."""
    size = across.shape[1]
    inner = across[:, SHOULDER : size - SHOULDER]
    return inner - 0.5 * (across[:, : size - 2 * SHOULDER] + across[:, 2 * SHOULDER :])


def ridge_sigma(
    values: Float[ArrayLike, "b r"], inside: Bool[ArrayLike, "b"], least: Float[ArrayLike, ""]
) -> Float[ArrayLike, ""]:
    """Standard deviation of one block's ridge about what is common along the probe; at least
    `least`, that of the picture's noise."""
    # Second differences: neither what is common nor what changes evenly counts, such as an edge
    # that comes nearer.
    change = jnp.abs(values[2:] - 2 * values[1:-1] + values[:-2])
    known = (inside[2:] & inside[1:-1] & inside[:-2])[:, None]
    middle = jnp.nanmedian(jnp.where(known, change, jnp.nan))
    gain = jnp.asarray(_MAD / np.sqrt(6 - 8 * NEXT + 2 * SECOND), dtype=values.dtype)
    return jnp.maximum(jnp.nan_to_num(gain * middle), least)


def windows(
    values: Float[ArrayLike, "l b"], growth: Float[ArrayLike, "k"]
) -> Float[ArrayLike, "l x"]:
    """Sums over all windows, over the root of blocks times growth."""
    spread = jnp.sqrt(jnp.asarray(WINDOW_SIZE, values.dtype) * growth[_WINDOW_KIND])
    return values @ jnp.asarray(_IN_WINDOW, values.dtype) / spread[None]


def whole_windows(inside: Bool[ArrayLike, "*l b"]) -> Bool[ArrayLike, "*l x"]:
    """Whether all blocks of each window are inside."""
    outside = jnp.where(inside, 0.0, 1.0) @ jnp.asarray(_IN_WINDOW, float)
    return outside < 0.5


@jax.jit
def window_scores(
    gradient: Float[ArrayLike, "h w 2"],
    least: Float[ArrayLike, ""],
    uv_px: Float[ArrayLike, "n s 2"],
    normal: Float[ArrayLike, "n s 2"],
    inside: Bool[ArrayLike, "n s"],
) -> tuple[Float[ArrayLike, "n x"], Bool[ArrayLike, "n x"]]:
    """Sums of ridge, over sigma and the root of blocks, of every window on each probe itself."""

    def one(uv: ArrayLike, across: ArrayLike, held: ArrayLike) -> tuple[ArrayLike, ArrayLike]:
        values, _, known = block_gradients(gradient, uv, across, held)
        height = ridge(values)
        sigma = ridge_sigma(height, known, least)
        same = jnp.ones(len(WINDOWS), height.dtype)
        return windows((height[:, REACH] / sigma)[None], same)[0], whole_windows(known)

    return jax.vmap(one)(uv_px, normal, inside)
