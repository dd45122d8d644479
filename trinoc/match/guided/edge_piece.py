"""From where to where an edge goes along a probe, and where across it lies."""

import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.match.guided.probes import BLOCKS
from trinoc.match.guided.ridges import SHOULDER
from trinoc.numerics import ArrayLike

# What one block may say for or against an edge that goes on, log likelihood.
_MOST_OF_BLOCK = 4.0


def extent_of(
    own: Float[ArrayLike, "b"],
    mean: Float[ArrayLike, ""],
    usable: Bool[ArrayLike, "b"],
    begin: Int[ArrayLike, ""],
    end: Int[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
) -> tuple[ArrayLike, ArrayLike, ArrayLike]:
    """From where to where the edge goes on at the height of its window, by likelihood."""
    blocks = jnp.arange(BLOCKS, dtype=jnp.int32)
    gain = jnp.clip((own * mean - 0.5 * mean**2) / growth[0], -_MOST_OF_BLOCK, _MOST_OF_BLOCK)
    gain = jnp.where(usable, gain, -4 * _MOST_OF_BLOCK)
    # Ends may move inward as well: half a window's first and last blocks may hold no edge.
    half = (begin + end) // 2
    right = jnp.where(blocks >= half, gain, 0.0)
    left = jnp.where(blocks < half, gain, 0.0)
    # Cut k: the edge goes on up to block k, excluded, or from block k on.
    cuts = jnp.arange(BLOCKS + 1, dtype=jnp.int32)
    places = cuts.astype(own.dtype)
    zero = jnp.zeros(1, own.dtype)
    up_to = jnp.concatenate([zero, jnp.cumsum(right)])
    up_to = jnp.where(cuts > half, up_to, -jnp.inf)
    from_on = jnp.concatenate([jnp.cumsum(left[::-1])[::-1], zero])
    from_on = jnp.where(cuts <= half, from_on, -jnp.inf)

    def spread(log: ArrayLike) -> ArrayLike:
        weight = jax.nn.softmax(log)
        middle = (weight * places).sum()
        return jnp.sqrt((weight * (places - middle) ** 2).sum() + 1 / 12)

    sigmas = jnp.stack([spread(from_on), spread(up_to)])
    first, last = (jnp.argmax(log).astype(jnp.int32) for log in (from_on, up_to))
    return first, last, sigmas


def placed(
    across: Float[ArrayLike, "b o"],
    column: Int[ArrayLike, "b"],
    at: Float[ArrayLike, "b"],
    first: Int[ArrayLike, ""],
    last: Int[ArrayLike, ""],
    sigma: Float[ArrayLike, ""],
    growth: Float[ArrayLike, "k"],
) -> tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike]:
    """(place in either half, its variance, contrast, asymmetry), by a log-parabola."""
    blocks = jnp.arange(BLOCKS, dtype=jnp.int32)
    count = jnp.maximum(last - first, 1)
    split = first + (count + 1) // 2
    near = jnp.stack([across[blocks, column + k] for k in (-SHOULDER, -1, 0, 1, SHOULDER)])
    halves = jnp.stack([(blocks >= first) & (blocks < split), (blocks >= split) & (blocks < last)])
    halves = halves.astype(across.dtype)
    number = jnp.maximum(halves.sum(axis=1), 1.0)
    means = (near[None] * halves[:, None]).sum(axis=2) / number[:, None]
    whole = (means * number[:, None]).sum(axis=0) / number.sum()
    top = jnp.maximum(whole[2], 1e-3)
    log = jnp.log(jnp.maximum(whole[1:4], 0.05 * top))
    bend = jnp.maximum(2 * log[1] - log[0] - log[2], 0.05)
    log = jnp.log(jnp.maximum(means[:, 1:4], 0.05 * top))
    shift = jnp.clip((log[:, 2] - log[:, 0]) / (2 * bend), -1.5, 1.5)
    where = (at[None] * halves).sum(axis=1) / number + shift
    # The difference of two places, 2 px apart, has about the ridge's own variance.
    variance = growth[2] / number * sigma**2 / (2 * bend * top) ** 2
    width = 1 / jnp.sqrt(bend)
    contrast = top * width * jnp.sqrt(2 * jnp.pi).astype(across.dtype)
    return where, variance, contrast, (whole[4] - whole[0]) / top
