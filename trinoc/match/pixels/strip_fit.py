"""Fit the image of a line to all blocks of pixels beside it, by Gauss-Newton."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import BlockFit, fit_block
from trinoc.match.pixels.strips import Strips, connected_to_middle
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.numerics.buckets import in_blocks
from trinoc.numerics.joins import group_medians, group_sums
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.small_least_squares import NormalEquations

# numerical: number of blocks per call.
BLOCKS_AT_ONCE = 64
# numerical: number of Gauss-Newton steps.
_STEPS = 7
# numerical: number of first steps that use only the core, with equal weights of all blocks.
_CORE_STEPS = 2
# numerical: largest step of both offsets, px, and of the logarithm of the blur.
_LARGEST_STEP = np.array([0.7, 0.7, 0.3])
# numerical: smallest number of pixels of a block on either side, and its own parameters.
_MIN_PIXELS, _BLOCK_PARAMETERS = 8, 6


class StripFit(NamedTuple):
    """Positions of s line images in one view, fitted to the pixels.

    The pixels beside a line are divided into blocks of a few rows.

    Attributes
    ----------
    parameters : (s, 3)
        Offsets of the image at both ends, px, and logarithm of the blur.
    information : (s, 3, 3)
        Information matrix of the parameters.
    chi_square : (s,)
        Reduced chi-square of the blocks under the image's noise, median over the blocks.
    scatter : (s,)
        Sum of the squared distances of the blocks from the fitted image, in standard deviations.
    blocks : (s,)
        Number of accepted blocks.
    share : (s,)
        Share of the blocks with a weight above 0.3.
    """

    parameters: Float[np.ndarray, "s 3"]
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
    columns: Bool[ArrayLike, "b c"],
    parameters: Float[ArrayLike, "b 3"],
    noise: Float[ArrayLike, "b"],
) -> BlockFit:
    return jax.vmap(fit_block, in_axes=(None, None, 0, 0, 0, 0, 0, 0, 0))(
        core, slopes, across_px, share, level, usable, columns, parameters, noise
    )


def fit_strips(
    strips: Strips,
    start_px: Float[np.ndarray, "s 2"],
    noise: float,
    log_blur: tuple[float, float],
    tuning: PixelTuning,
) -> StripFit:
    """Fit the images of lines to their pixels.

    Grey levels, blur and noise are estimated separately for each line. Blocks that do not fit the
    others get small weights.

    Parameters
    ----------
    strips : Strips
        Blocks of pixels of all lines.
    start_px : (s, 2)
        Initial offsets at both ends of each line.
    noise : float
        Standard deviation of the grey levels.
    log_blur : (float, float)
        Prior mean and standard deviation of the logarithm of the blur.
    tuning : PixelTuning
        Tuned constants.
    """
    count, line = len(start_px), strips.line
    parameters = np.column_stack([start_px, np.full(count, log_blur[0])])
    columns = np.zeros(strips.level.shape[::2], dtype=bool)
    core = np.array([tuning.core_widths, tuning.core_px])
    slopes = np.array([tuning.across_slope, tuning.along_slope])
    block_noise = np.full(len(line), noise)

    def blocks(*columns: np.ndarray) -> BlockFit:
        return _blocks(core, slopes, *columns)

    prior_information = np.array([0.0, 0.0, 1 / log_blur[1] ** 2])
    for step in range(_STEPS):
        arguments = (*strips[:4], columns, parameters[line], block_noise)
        blocks_fit = in_blocks(blocks, BLOCKS_AT_ONCE, *arguments)
        sums = _sum_blocks(blocks_fit, line, count, noise, step > 1, tuning)
        if step == _STEPS - 1:
            break
        prior_offset = parameters - np.array([0.0, 0.0, log_blur[0]])
        equations = NormalEquations(
            sums.information + np.diag(prior_information),
            prior_information * prior_offset - sums.gradient,
            prior_offset,
            prior_offset,
        )
        parameters = parameters + equations.step(_LARGEST_STEP)
        if step + 1 >= _CORE_STEPS:
            columns = _extend_columns(
                blocks_fit, strips.usable, noise * np.sqrt(sums.noise[line]), tuning
            )
    total = np.maximum(np.bincount(line, minlength=count), 1)
    return StripFit(
        parameters,
        sums.information,
        sums.chi_square,
        sums.scatter,
        sums.blocks,
        sums.accepted_blocks / total,
    )


class _LineSums(NamedTuple):
    """Sums over the blocks of each line.

    `information` and `gradient` are those of the normal equations. `noise` is the noise variance of
    each line over that of the image. `accepted_blocks` counts the blocks with a weight above 0.3.
    Other attributes are as in `StripFit`.
    """

    information: Float[np.ndarray, "s 3 3"]
    gradient: Float[np.ndarray, "s 3"]
    noise: Float[np.ndarray, "s"]
    chi_square: Float[np.ndarray, "s"]
    scatter: Float[np.ndarray, "s"]
    blocks: Float[np.ndarray, "s"]
    accepted_blocks: Float[np.ndarray, "s"]


def _sum_blocks(
    fit: BlockFit,
    line: Int[np.ndarray, "b"],
    count: int,
    noise: float,
    robust: bool,
    tuning: PixelTuning,
) -> _LineSums:
    """Sum the normal equations over the blocks of each line.

    Blocks with a large chi-square or with the brighter side reversed have weight 0. With `robust`,
    blocks far from the line have small weights.
    """
    fit = BlockFit(*(np.asarray(column) for column in fit))
    freedom = np.maximum(fit.count.sum(axis=1) - _BLOCK_PARAMETERS, 1)
    is_complete = (fit.count >= _MIN_PIXELS).all(axis=1)
    chi = np.asarray(fit.square / freedom / noise**2)
    median_chi_square = group_medians(chi[is_complete], line[is_complete], count)
    median_chi_square = np.where(np.isfinite(median_chi_square), median_chi_square, 1.0)
    scale = np.maximum(median_chi_square, tuning.min_noise)
    limit = 1 + tuning.block_chi_sigmas * np.sqrt(2 / freedom)
    is_good = is_complete & (chi < scale[line] * limit)
    # All blocks of an edge have the same brighter side.
    bright_side = np.sign(group_sums(np.where(is_good, fit.step, 0.0), line, count))
    is_good &= np.sign(fit.step) == bright_side[line]
    variance = (scale * noise**2)[line]
    information = fit.information[:, :2, :2].sum(axis=(1, 2))
    distance_sigmas = fit.gradient[:, :2].sum(axis=1) / np.sqrt(
        np.maximum(information, 1e-12) * variance
    )
    weight = np.where(is_good, 1.0, 0.0)
    if robust:
        weight = weight / (1 + np.square(distance_sigmas / tuning.block_sigmas))
    weight_over_variance = weight / variance
    return _LineSums(
        group_sums(np.asarray(fit.information * weight_over_variance[:, None, None]), line, count),
        group_sums(np.asarray(fit.gradient * weight_over_variance[:, None]), line, count),
        scale,
        median_chi_square,
        group_sums(np.where(is_good, distance_sigmas**2, 0.0), line, count),
        group_sums(is_good.astype(np.float64), line, count),
        group_sums((weight > 0.3).astype(np.float64), line, count),
    )


def _extend_columns(
    fit: BlockFit,
    usable: Bool[np.ndarray, "b r c"],
    noise: Float[np.ndarray, "b"],
    tuning: PixelTuning,
) -> Bool[np.ndarray, "b c"]:
    """Return the mask of the columns to use in the next step of the fit, (b, c).

    A column contains the pixels of a block at one distance from the edge. A column is used if its
    mean agrees with the fitted levels, and all columns up to the edge are used.
    """
    pixel_count = usable.sum(axis=1)
    limit = tuning.ring_sigmas * noise[:, None] * np.sqrt(np.maximum(pixel_count, 1))
    is_explained = (pixel_count > 0) & (np.abs(fit.column) <= limit)
    return connected_to_middle(is_explained | fit.inner)
