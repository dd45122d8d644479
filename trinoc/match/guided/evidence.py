"""Whether a picture shows an edge at a known place and in a known direction, and from where to where.

Along a probe the gradient across it is averaged over blocks. An edge is a ridge of that gradient:
what stands above the mean of the gradient SHOULDER px to both sides, so that shading, however steep,
is none. Of white or coloured noise the sum of n blocks has the variance n sigma^2 g(n), with
sigma of the probe itself and g of the picture (`false_alarms.py`). All windows of blocks, and all
lines within the gate, are tests of their own, and are counted.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.gradient import SMOOTHING_PX
from trinoc.match.guided.probes import BLOCKS, STEP_PX
from trinoc.numerics import ArrayLike

SHOULDER = 3
REACH = 2
# Places across, px.
OFFSETS = np.arange(-REACH - SHOULDER, REACH + SHOULDER + 1)
# Score above which an edge is no surer for being stronger: the nearest of such is the line's own.
_SURE = 8.0
# How far the line's two ends may lie on different sides of the probe, px.
TILTS = np.array([-2, 0, 2])
# Blocks of a window; one begins half a window after the other.
WINDOWS = (2, 4, 8, 16, 32)
_BEGIN = [np.arange(0, BLOCKS - size + 1, max(size // 2, 1)) for size in WINDOWS]
WINDOW_FIRST = np.concatenate(_BEGIN)
WINDOW_SIZE = np.repeat(WINDOWS, [len(begin) for begin in _BEGIN])
_BLOCK = np.arange(BLOCKS)[:, None]
_IN_WINDOW = (_BLOCK >= WINDOW_FIRST) & (_BLOCK < WINDOW_FIRST + WINDOW_SIZE)
# An edge that crosses the line has a gradient along it: at most this share of that across, and
# what noise adds to it, in standard deviations.
_OBLIQUE, _OBLIQUE_NOISE = 0.15, 1.5
# What one block may say for or against an edge that goes on, log likelihood.
_MOST_OF_BLOCK = 4.0
_MAD = 1.4826
# What white noise has in common in a block and the next, and the one after that.
_ONE, _TWO, _THREE = (np.exp(-((k * STEP_PX / SMOOTHING_PX) ** 2) / 4) for k in (1, 2, 3))
NEXT = float((_ONE + 2 * _TWO + _THREE) / (2 + 2 * _ONE))
SECOND = float((_THREE) / (2 + 2 * _ONE))


class Evidence(NamedTuple):
    """Of each probe, the window of blocks and the line across that shows an edge best.

    Fields
    ------
    score : the sum of its ridge in standard deviations, without sign.
    sign : +1 where it is brighter on the right.
    first, last : blocks from where to where the edge goes, last excluded.
    end_sigma : (2,) standard deviations of these, in blocks.
    offset_px : (2,) where the edge lies across, in the middles of its first and second half.
    variance_px2 : (2,) of these, from noise.
    contrast : grey levels of the step.
    width_px : standard deviation of its profile.
    asymmetry : how far its two shoulders differ, as a share of its height.
    excess : sigma of its blocks over what the picture's noise makes of them, at least 1.
    tests : windows and lines that were looked at.
    """

    score: Float[ArrayLike, "*n"]
    sign: Float[ArrayLike, "*n"]
    first: Int[ArrayLike, "*n"]
    last: Int[ArrayLike, "*n"]
    end_sigma: Float[ArrayLike, "*n 2"]
    offset_px: Float[ArrayLike, "*n 2"]
    variance_px2: Float[ArrayLike, "*n 2"]
    contrast: Float[ArrayLike, "*n"]
    width_px: Float[ArrayLike, "*n"]
    asymmetry: Float[ArrayLike, "*n"]
    excess: Float[ArrayLike, "*n"]
    tests: Float[ArrayLike, "*n"]


def block_gradients(
    gradient: Float[ArrayLike, "h w 2"],
    uv_px: Float[ArrayLike, "s 2"],
    normal: Float[ArrayLike, "s 2"],
    inside: Bool[ArrayLike, "s"],
) -> tuple[Float[ArrayLike, "b o"], Float[ArrayLike, "b o"], Bool[ArrayLike, "b"]]:
    """(gradient across and along at OFFSETS, means of each block's two places; whether both are
    inside)."""
    across = jnp.asarray(OFFSETS, dtype=gradient.dtype)
    places = uv_px[:, None] + across[:, None] * normal[:, None]
    height, width, _ = gradient.shape
    low = jnp.clip(jnp.floor(places), 0, jnp.array([width - 2, height - 2], gradient.dtype))
    share = jnp.clip(places - low, 0, 1)
    u, v = (low[..., k].astype(jnp.int32) for k in (0, 1))
    flat = gradient.reshape(-1, 2)
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
    held = inside.reshape(BLOCKS, 2).all(axis=1)
    return *(x.reshape(BLOCKS, 2, -1).mean(axis=1) for x in (across, along)), held


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


def _windows(
    values: Float[ArrayLike, "l b"], growth: Float[ArrayLike, "k"]
) -> Float[ArrayLike, "l w"]:
    """Sums over all windows, over the root of blocks times growth."""
    spread = jnp.sqrt(WINDOW_SIZE * jnp.repeat(growth, np.array([len(b) for b in _BEGIN]), total_repeat_length=len(WINDOW_FIRST)))
    return values @ jnp.asarray(_IN_WINDOW, values.dtype) / spread.astype(values.dtype)


def _whole(inside: Bool[ArrayLike, "*l b"]) -> Bool[ArrayLike, "*l w"]:
    """Whether all blocks of each window are inside."""
    kind = jnp.float32
    outside = (~inside).astype(kind) @ jnp.asarray(_IN_WINDOW, kind)
    return outside < 0.5


def probe_evidence(
    gradient: Float[ArrayLike, "h w 2"],
    least: Float[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
    uv_px: Float[ArrayLike, "s 2"],
    normal: Float[ArrayLike, "s 2"],
    inside: Bool[ArrayLike, "s"],
    gate_px: Float[ArrayLike, ""],
    near_px: Float[ArrayLike, ""],
    latest: Int[ArrayLike, ""],
) -> Evidence:
    """The best window of a probe that begins at block `latest` or before, within the gate.

    `near_px` is the standard deviation of the line's place.

    `least` is the standard deviation of a block's ridge from the picture's noise, `growth` is
    g(n) of every window's size.
    """
    across, along, known = block_gradients(gradient, uv_px, normal, inside)
    height = ridge(across)
    sigma = ridge_sigma(height, known, least)
    count = jnp.maximum(known.sum(), 1)
    # Lines within the reach, and one more to either side: where each is at every block.
    place = (jnp.arange(BLOCKS) + 0.5) / count - 0.5
    middle = jnp.arange(-REACH - 1, REACH + 2).astype(height.dtype)
    tilt = jnp.asarray(TILTS, dtype=height.dtype)[:, None, None]
    at = middle[None, :, None] + jnp.rint(tilt * place.astype(height.dtype))
    allowed = (jnp.abs(at[:, 1:-1]) <= jnp.minimum(gate_px, REACH)) & known
    rows = jnp.arange(BLOCKS)

    def summed(part: jax.Array, lines: jax.Array) -> jax.Array:
        own = part[rows, jnp.clip(lines + SHOULDER + REACH, 0, len(OFFSETS) - 1).astype(jnp.int32)]
        flat = (own / sigma).reshape(-1, BLOCKS)
        sums = _windows(flat, growth)
        return sums.reshape(len(TILTS), lines.shape[1], -1)

    padded = jnp.pad(height, ((0, 0), (SHOULDER, SHOULDER)))
    inner = at[:, 1:-1]
    scores, beside, plain = summed(padded, inner), summed(along, inner), summed(across, at)
    size = jnp.abs(plain)
    top = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:])
    plain = plain[:, 1:-1]
    whole = _whole(allowed) & (jnp.asarray(WINDOW_FIRST) <= latest)
    straight = jnp.abs(beside) < _OBLIQUE * jnp.abs(plain) + _OBLIQUE_NOISE
    good = whole & top & straight & (jnp.sign(scores) == jnp.sign(plain))
    # Of edges that are sure, the nearest to the line; of others, the surest.
    off = inner.mean(axis=2)[..., None] / jnp.maximum(near_px, 0.3)
    value = jnp.minimum(jnp.abs(scores), _SURE) ** 2 + 0.1 * jnp.abs(scores) - off**2
    value = jnp.where(good, value, -jnp.inf)
    value, good, scores = (x.reshape(-1, x.shape[-1]) for x in (value, good, scores))
    at, column = inner.reshape(-1, BLOCKS), (inner + REACH).reshape(-1, BLOCKS)
    column = jnp.clip(column, 0, 2 * REACH).astype(jnp.int32)
    allowed = allowed.reshape(-1, BLOCKS)
    of_line = height[rows, column]
    best = jnp.argmax(value)
    line, window = jnp.divmod(best, good.shape[1])
    score = jnp.where(good.reshape(-1)[best], jnp.abs(scores).reshape(-1)[best], 0.0)
    begin = jnp.asarray(WINDOW_FIRST)[window]
    size = jnp.asarray(WINDOW_SIZE)[window]
    sign = jnp.sign(scores[line, window])
    own, usable = sign * of_line[line], allowed[line]
    within = (rows >= begin) & (rows < begin + size)
    mean = (own * within).sum() / size
    first, last, end_sigma = _extent(own / sigma, mean / sigma, usable, begin, begin + size, growth)
    first = jnp.minimum(first, begin)
    measured = _placed(sign * across, column[line] + SHOULDER, at[line], first, last, sigma, growth)
    tests = whole.sum().astype(height.dtype)
    return Evidence(score, sign, first, last, end_sigma, *measured, sigma / least, tests)


def _extent(
    own: Float[ArrayLike, "b"],
    mean: Float[ArrayLike, ""],
    usable: Bool[ArrayLike, "b"],
    begin: Int[ArrayLike, ""],
    end: Int[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
    """From where to where the edge goes on at the height of its window, by likelihood."""
    blocks = jnp.arange(BLOCKS)
    gain = jnp.clip((own * mean - 0.5 * mean**2) / growth[0], -_MOST_OF_BLOCK, _MOST_OF_BLOCK)
    gain = jnp.where(usable, gain, -4 * _MOST_OF_BLOCK)
    # Ends may move inward as well: half a window's first and last blocks may hold no edge.
    half = (begin + end) // 2
    right = jnp.where(blocks >= half, gain, 0.0)
    left = jnp.where(blocks < half, gain, 0.0)
    # Cut k: the edge goes on up to block k, excluded, or from block k on.
    cuts = jnp.arange(BLOCKS + 1)
    zero = jnp.zeros(1, own.dtype)
    up_to = jnp.concatenate([zero, jnp.cumsum(right)])
    up_to = jnp.where(cuts > half, up_to, -jnp.inf)
    from_on = jnp.concatenate([jnp.cumsum(left[::-1])[::-1], zero])
    from_on = jnp.where(cuts <= half, from_on, -jnp.inf)

    def spread(log: jax.Array) -> jax.Array:
        weight = jax.nn.softmax(log)
        middle = (weight * cuts).sum()
        return jnp.sqrt((weight * (cuts - middle) ** 2).sum() + 1 / 12)

    sigmas = jnp.stack([spread(from_on), spread(up_to)])
    return jnp.argmax(from_on), jnp.argmax(up_to), sigmas


def _placed(
    across: Float[ArrayLike, "b o"],
    column: Int[ArrayLike, "b"],
    at: Float[ArrayLike, "b"],
    first: Int[ArrayLike, ""],
    last: Int[ArrayLike, ""],
    sigma: Float[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
) -> tuple[ArrayLike, ...]:
    """(place in either half, its variance, contrast, width, asymmetry), by a log-parabola."""
    blocks = jnp.arange(BLOCKS)
    count = jnp.maximum(last - first, 1)
    split = first + (count + 1) // 2
    near = jnp.stack([across[blocks, column + k] for k in (-SHOULDER, -1, 0, 1, SHOULDER)])
    halves = jnp.stack([(blocks >= first) & (blocks < split), (blocks >= split) & (blocks < last)])
    number = jnp.maximum(halves.sum(axis=1), 1).astype(across.dtype)
    means = (near[None] * halves[:, None]).sum(axis=2) / number[:, None]
    whole = (means * number[:, None]).sum(axis=0) / number.sum()
    top = jnp.maximum(whole[2], 1e-3)
    log = jnp.log(jnp.maximum(whole[1:4], 0.05 * top))
    bend = jnp.maximum(2 * log[1] - log[0] - log[2], 0.05)
    log = jnp.log(jnp.maximum(means[:, 1:4], 0.05 * top))
    shift = jnp.clip((log[:, 2] - log[:, 0]) / (2 * bend), -1.5, 1.5)
    where = (at * halves).sum(axis=1) / number + shift
    # The difference of two places, 2 px apart, has about the ridge's own variance.
    variance = growth[2] / number * sigma**2 / (2 * bend * top) ** 2
    width = 1 / jnp.sqrt(bend)
    contrast = top * width * jnp.sqrt(2 * jnp.pi).astype(across.dtype)
    return where, variance, contrast, width, (whole[4] - whole[0]) / top


@partial(jax.jit)
def evidence_along(
    gradient: Float[ArrayLike, "h w 2"],
    least: Float[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
    uv_px: Float[ArrayLike, "n s 2"],
    normal: Float[ArrayLike, "n s 2"],
    inside: Bool[ArrayLike, "n s"],
    gate_px: Float[ArrayLike, "n"],
    near_px: Float[ArrayLike, "n"],
    latest: Int[ArrayLike, "n"],
) -> Evidence:
    """`probe_evidence` of many probes of one picture."""
    each = jax.vmap(probe_evidence, in_axes=(None, None, None, 0, 0, 0, 0, 0, 0))
    return each(gradient, least, growth, uv_px, normal, inside, gate_px, near_px, latest)


@jax.jit
def window_scores(
    gradient: Float[ArrayLike, "h w 2"],
    least: Float[ArrayLike, ""],
    uv_px: Float[ArrayLike, "n s 2"],
    normal: Float[ArrayLike, "n s 2"],
    inside: Bool[ArrayLike, "n s"],
) -> tuple[Float[ArrayLike, "n w"], Bool[ArrayLike, "n w"]]:
    """Sums of ridge, over sigma and the root of blocks, of every window on each probe itself."""

    def one(uv: jax.Array, across: jax.Array, held: jax.Array) -> tuple[ArrayLike, ArrayLike]:
        values, _, known = block_gradients(gradient, uv, across, held)
        height = ridge(values)
        sigma = ridge_sigma(height, known, least)
        same = jnp.ones(len(WINDOWS), height.dtype)
        return _windows((height[:, REACH] / sigma)[None], same)[0], _whole(known)

    return jax.vmap(one)(uv_px, normal, inside)
