"""Whether a picture shows an edge at a known place and in a known direction.

All windows of blocks, and all lines within the gate, are tests of their own, and are counted. Of
the edges that are sure the nearest to the known place is taken, since others may lie beside it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.edge_piece import extent_of, placed
from trinoc.match.guided.probes import BLOCKS
from trinoc.match.guided.ridges import (
    OFFSETS,
    REACH,
    SHOULDER,
    WINDOW_FIRST,
    WINDOW_SIZE,
    block_gradients,
    ridge,
    ridge_sigma,
    whole_windows,
    windows,
)
from trinoc.numerics import ArrayLike

# How far the line's two ends may lie on different sides of the probe, px.
TILTS = np.array([-2, 0, 2])
# Score above which an edge is no surer for being stronger: the nearest of such is the line's own.
_SURE = 8.0
# An edge that crosses the line has a gradient along it: at most this share of that across, and
# what noise adds to it, in standard deviations.
_OBLIQUE, _OBLIQUE_NOISE = 0.15, 1.5


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
    asymmetry: Float[ArrayLike, "*n"]
    excess: Float[ArrayLike, "*n"]
    tests: Float[ArrayLike, "*n"]


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

    `near_px` is the standard deviation of the line's place, `least` that of a block's ridge from
    the picture's noise, and `growth` is g(n) of every window's size.
    """
    across, along, known = block_gradients(gradient, uv_px, normal, inside)
    height = ridge(across)
    sigma = ridge_sigma(height, known, least)
    kind = height.dtype
    count = jnp.maximum(known.sum(), 1).astype(kind)
    # Lines within the reach, and one more to either side: where each is at every block.
    place = (jnp.arange(BLOCKS, dtype=kind) + 0.5) / count - 0.5
    middle = jnp.arange(-REACH - 1, REACH + 2).astype(kind)
    tilt = jnp.asarray(TILTS, dtype=kind)[:, None, None]
    at = middle[None, :, None] + jnp.rint(tilt * place[None, None])
    allowed = (jnp.abs(at[:, 1:-1]) <= jnp.minimum(gate_px, REACH)) & known[None, None]
    rows = jnp.arange(BLOCKS, dtype=jnp.int32)

    def summed(part: ArrayLike, lines: ArrayLike) -> ArrayLike:
        own = part[
            rows[None, None],
            jnp.clip(lines + SHOULDER + REACH, 0, len(OFFSETS) - 1).astype(jnp.int32),
        ]
        sums = windows((own / sigma).reshape(-1, BLOCKS), growth)
        return sums.reshape(len(TILTS), lines.shape[1], -1)

    padded = jnp.pad(height, ((0, 0), (SHOULDER, SHOULDER)))
    inner = at[:, 1:-1]
    scores, beside, plain = summed(padded, inner), summed(along, inner), summed(across, at)
    size = jnp.abs(plain)
    top = (size[:, 1:-1] >= size[:, :-2]) & (size[:, 1:-1] >= size[:, 2:])
    plain = plain[:, 1:-1]
    begins = jnp.asarray(WINDOW_FIRST, jnp.int32) <= latest
    whole = whole_windows(allowed) & begins[None, None]
    straight = jnp.abs(beside) < _OBLIQUE * jnp.abs(plain) + _OBLIQUE_NOISE
    good = whole & top & straight & (jnp.sign(scores) == jnp.sign(plain))
    # Of edges that are sure, the nearest to the line; of others, the surest.
    ends = jnp.abs(inner[..., WINDOW_FIRST]), jnp.abs(inner[..., WINDOW_FIRST + WINDOW_SIZE - 1])
    off = jnp.maximum(*ends) / jnp.maximum(near_px, 0.3)
    value = jnp.minimum(jnp.abs(scores), _SURE) ** 2 + 2 * jnp.log1p(jnp.abs(scores)) - off**2
    value = jnp.where(good, value, -jnp.inf)
    value, good, scores = (x.reshape(-1, x.shape[-1]) for x in (value, good, scores))
    at, column = inner.reshape(-1, BLOCKS), (inner + REACH).reshape(-1, BLOCKS)
    column = jnp.clip(column, 0, 2 * REACH).astype(jnp.int32)
    allowed = allowed.reshape(-1, BLOCKS)
    of_line = height[rows[None], column]
    best = jnp.argmax(value)
    line, window = jnp.divmod(best, good.shape[1])
    score = jnp.where(good.reshape(-1)[best], jnp.abs(scores).reshape(-1)[best], 0.0)
    begin = jnp.asarray(WINDOW_FIRST, jnp.int32)[window]
    size = jnp.asarray(WINDOW_SIZE, jnp.int32)[window]
    sign = jnp.sign(scores[line, window])
    own, usable = sign * of_line[line], allowed[line]
    within = (rows >= begin) & (rows < begin + size)
    mean = jnp.where(within, own, 0.0).sum() / size.astype(kind)
    first, last, end_sigma = extent_of(
        own / sigma, mean / sigma, usable, begin, begin + size, growth
    )
    own = sign * across, column[line] + SHOULDER, at[line]
    offset, variance, contrast, asymmetry = placed(*own, first, last, sigma, growth)
    tests = whole.sum().astype(kind)
    return Evidence(
        score,
        sign,
        first,
        last,
        end_sigma,
        offset,
        variance,
        contrast,
        asymmetry,
        sigma / least,
        tests,
    )


@jax.jit
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
