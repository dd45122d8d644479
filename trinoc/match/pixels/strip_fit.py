"""All blocks beside a line together: where its image is, by Gauss and Newton."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import BlockFit, fit_block
from trinoc.match.pixels.strips import Strips, outward
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.joins import group_medians, group_sums
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.small_least_squares import NormalEquations

# numerical: a block size.
BLOCKS_AT_ONCE = 64
# numerical: Gauss-Newton steps, which converge.
_STEPS = 7
# numerical: the first steps fit the core alone, with all blocks alike.
_CORE_STEPS = 2
# Of both offsets, and of the logarithm of the blur.
# numerical: limits of a step.
_LARGEST_STEP = np.array([0.7, 0.7, 0.3])
# numerical: pixels that a block must have on either side, and unknowns that it has of its own.
_LEAST_PIXELS, _OWN_UNKNOWNS = 8, 6


class StripFit(NamedTuple):
    """What the pixels say of the images of lines.

    Fields
    ------
    place : (s, 3) offsets at both ends, and logarithm of the blur. information : (s, 3, 3) of it.
    chi_square : (s,) of usual blocks, over degrees of freedom, at the picture's noise.
    scatter : (s,) sum of squares of the blocks' distances from the line, in standard deviations.
    blocks : (s,) how many count. share : (s,) of all.
    """

    place: Float[np.ndarray, "s 3"]
    information: Float[np.ndarray, "s 3 3"]
    chi_square: Float[np.ndarray, "s"]
    scatter: Float[np.ndarray, "s"]
    blocks: Float[np.ndarray, "s"]
    share: Float[np.ndarray, "s"]


@kept_jit
def _blocks(
    core: Float[ArrayLike, "2"],
    slopes: Float[ArrayLike, "2"],
    across_px: Float[ArrayLike, "b r c"],
    share: Float[ArrayLike, "b r c"],
    level: Float[ArrayLike, "b r c"],
    usable: Bool[ArrayLike, "b r c"],
    reach: Bool[ArrayLike, "b c"],
    place: Float[ArrayLike, "b 3"],
    noise: Float[ArrayLike, "b"],
) -> BlockFit:
    return jax.vmap(fit_block, in_axes=(None, None, 0, 0, 0, 0, 0, 0, 0))(
        core, slopes, across_px, share, level, usable, reach, place, noise
    )


def fit_strips(
    strips: Strips,
    start_px: Float[np.ndarray, "s 2"],
    noise: float,
    log_blur: tuple[float, float],
    tuning: PixelTuning,
) -> StripFit:
    """Fit the images of lines to their pixels, from offsets at their ends.

    `log_blur` is what is known of the logarithm of the blur before: mean and standard deviation.
    Each line's own levels, blur and noise are fitted; blocks that do not belong count less.
    """
    count, line = len(start_px), strips.line
    place = np.column_stack([start_px, np.full(count, log_blur[0])])
    reach = np.zeros(strips.level.shape[::2], dtype=bool)
    core = np.array([tuning.core_widths, tuning.core_px])
    slopes = np.array([tuning.across_slope, tuning.along_slope])
    every = np.full(len(line), noise)

    def blocks(*columns: np.ndarray) -> BlockFit:
        return _blocks(core, slopes, *columns)

    known = np.array([0.0, 0.0, 1 / log_blur[1] ** 2])
    for step in range(_STEPS):
        here = (*strips[:4], reach, place[line], every)
        found = in_blocks(blocks, BLOCKS_AT_ONCE, *here)
        weighed = _weigh(found, line, count, noise, step > 1, tuning)
        if step == _STEPS - 1:
            break
        off = place - np.array([0.0, 0.0, log_blur[0]])
        equations = NormalEquations(
            weighed.information + np.diag(known), known * off - weighed.gradient, off, off
        )
        place = place + equations.step(_LARGEST_STEP)
        if step + 1 >= _CORE_STEPS:
            reach = _grow(found, strips.usable, noise * np.sqrt(weighed.noise[line]), tuning)
    total = np.maximum(np.bincount(line, minlength=count), 1)
    return StripFit(
        place,
        weighed.information,
        weighed.chi_square,
        weighed.scatter,
        weighed.blocks,
        weighed.believed / total,
    )


class _LineSums(NamedTuple):
    """Of each line, by its pixels alone; `noise` and `chi_square` over the picture's variance."""

    information: Float[np.ndarray, "s 3 3"]
    gradient: Float[np.ndarray, "s 3"]
    noise: Float[np.ndarray, "s"]
    chi_square: Float[np.ndarray, "s"]
    scatter: Float[np.ndarray, "s"]
    blocks: Float[np.ndarray, "s"]
    believed: Float[np.ndarray, "s"]


def _weigh(
    found: BlockFit,
    line: Int[np.ndarray, "b"],
    count: int,
    noise: float,
    robust: bool,
    tuning: PixelTuning,
) -> _LineSums:
    """Sums over the blocks of each line; what is no step like the others' counts little."""
    found = BlockFit(*(np.asarray(column) for column in found))
    freedom = np.maximum(found.count.sum(axis=1) - _OWN_UNKNOWNS, 1)
    complete = (found.count >= _LEAST_PIXELS).all(axis=1)
    chi = np.asarray(found.square / freedom / noise**2)
    usual = group_medians(chi[complete], line[complete], count)
    usual = np.where(np.isfinite(usual), usual, 1.0)
    scale = np.maximum(usual, tuning.least_noise)
    limit = 1 + tuning.block_chi_sigmas * np.sqrt(2 / freedom)
    good = complete & (chi < scale[line] * limit)
    # All blocks of an edge are brighter on the same side.
    brighter = np.sign(group_sums(np.where(good, found.step, 0.0), line, count))
    good &= np.sign(found.step) == brighter[line]
    variance = (scale * noise**2)[line]
    own = found.information[:, :2, :2].sum(axis=(1, 2))
    off = found.gradient[:, :2].sum(axis=1) / np.sqrt(np.maximum(own, 1e-12) * variance)
    weight = np.where(good, 1.0, 0.0)
    if robust:
        weight = weight / (1 + np.square(off / tuning.block_sigmas))
    share = weight / variance
    return _LineSums(
        group_sums(np.asarray(found.information * share[:, None, None]), line, count),
        group_sums(np.asarray(found.gradient * share[:, None]), line, count),
        scale,
        usual,
        group_sums(np.where(good, off**2, 0.0), line, count),
        group_sums(good.astype(np.float64), line, count),
        group_sums((weight > 0.3).astype(np.float64), line, count),
    )


def _grow(
    found: BlockFit,
    usable: Bool[np.ndarray, "b r c"],
    noise: Float[np.ndarray, "b"],
    tuning: PixelTuning,
) -> Bool[np.ndarray, "b c"]:
    """The columns, from the core outward, whose mean the levels of their block explain."""
    number = usable.sum(axis=1)
    most = tuning.ring_sigmas * noise[:, None] * np.sqrt(np.maximum(number, 1))
    alike = (number > 0) & (np.abs(found.column) <= most)
    return outward(alike | found.inner)
