"""Edges whose bright side is saturated: where they are, from the side that is not.

A clipped step looks as if it lay farther toward its dark side. Below white its profile is still
that of the whole step: how steeply it rises there, beside how high it stands, tells where its
middle is, as far as the blur is known. Each line's mean profile is fitted with a blurred step of
unknown place, height, floor and blur; what other edges of the picture say about the blur, and how
far surfaces usually are above white, joins in as prior knowledge.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtri

from trinoc.numerics import members
from trinoc.segments.nevatia_babu.edge_errors import ErrorModel
from trinoc.segments.nevatia_babu.edge_points import EdgePoints
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.shifts import Shifts
from trinoc.segments.nevatia_babu.step_fit import step_fit
from trinoc.segments.tuning import DEFAULT, SaturationTuning

_BIN_PX = 0.25
# The profile is looked at so far to both sides, and fitted from so many widths before the line.
_REACH_PX, _WIDTHS = 9, 3.5
_LEAST_BINS, _MOST_WIDTHS = 5, 3.0
# The fit starts from steps so high, in logarithms of the height over the visible one.
_STARTS = np.array([0.05, 0.4, 1.0])
_SIGMAS_BELOW_WHITE = 2.5
# The blur comes from so many of the longest edges without saturation, that have less than this
# share of their points beside others and so many times the noise in contrast.
_REFERENCES, _CLEAR_OF_OTHERS, _CLEAR_CONTRAST = 40, 0.2, 8.0
_CLEAR_REACH_PX = 4.0


def shifts_of_saturated(
    light: Float[np.ndarray, "h w"],
    white: float,
    noise: Float[np.ndarray, "r"],
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    disturbed: ErrorModel,
    tuning: SaturationTuning = DEFAULT.saturation,
) -> Shifts:
    """Fit the unsaturated part of each saturated line's profile; others are not moved.

    `white` and each line's `noise` are on the scale of `light`; points lie line after line from
    first[k] on.
    """
    shift, variance = np.zeros(len(first)), np.zeros(len(first))
    saturated = disturbed.saturated > tuning.from_share
    chosen = np.flatnonzero(saturated)
    if len(chosen) == 0:
        return Shifts(shift, variance, variance)
    clear = (disturbed.saturated == 0) & (disturbed.crowded < _CLEAR_OF_OTHERS)
    clear &= lines.contrast * lines.light_per_level > _CLEAR_CONTRAST * noise
    references = np.flatnonzero(clear)
    references = references[np.argsort(-lines.support[references], kind="stable")[:_REFERENCES]]
    both = np.concatenate([chosen, references])
    across, level, count = _profiles(light, points, first, lines, both)
    of = slice(len(chosen), None)
    rise = (lines.contrast * lines.light_per_level)[references]
    blur = _blur_of_clear(across[of], level[of], count[of], rise, noise[references, None], tuning)
    of = slice(0, len(chosen))
    shift[chosen], variance[chosen] = _fitted(
        across[of], level[of], count[of], white, noise[chosen, None], blur, tuning
    )
    return Shifts(shift, variance, np.square(tuning.uneven_share * shift))


class BlurPrior(NamedTuple):
    """The width of the blur of a picture's edges, pixel included: logarithm and its deviation."""

    log_width: float
    sigma: float


def _blur_of_clear(
    across: Float[np.ndarray, "s b"],
    level: Float[np.ndarray, "s b"],
    count: Int[np.ndarray, "s b"],
    rise: Float[np.ndarray, "s"],
    noise: Float[np.ndarray, "s 1"],
    tuning: SaturationTuning,
) -> BlurPrior:
    """The blur that clear edges without saturation have, and how much it differs among them."""
    unknown = float(np.log(tuning.unknown_blur_px)), tuning.unknown_spread
    if len(rise) < tuning.least_edges:
        return BlurPrior(*unknown)
    used = (count > 0) & (np.abs(across) < _CLEAR_REACH_PX)
    information = _information(used, count, noise, rise, tuning)
    start = np.zeros((len(rise), 4))
    start[:, 2] = np.where(used, level, np.inf).min(axis=1)
    start[:, 3] = unknown[0]
    weight = np.array([1.0, 1 / tuning.log_above_sigma**2, 0.0, 1 / unknown[1] ** 2])
    fit = step_fit(across, level, information, rise, start, start, weight, -np.inf)
    low, middle, high = np.quantile(fit.log_width, (0.16, 0.5, 0.84))
    return BlurPrior(float(middle), float(np.hypot((high - low) / 2, tuning.blur_spread)))


def _information(
    used: Bool[np.ndarray, "s b"],
    count: Int[np.ndarray, "s b"],
    noise: Float[np.ndarray, "s 1"],
    rise: Float[np.ndarray, "s"],
    tuning: SaturationTuning,
) -> np.ndarray:
    variance = noise**2 / np.maximum(count, 1) + np.square(tuning.misfit * rise[:, None])
    return np.where(used, 1 / variance, 0.0)


def _profiles(
    light: Float[np.ndarray, "h w"],
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    chosen: Int[np.ndarray, "s"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(across, level, count), each (s, bins): mean profiles; across counts toward the bright side.

    Each point gives the pixels of the picture's row or column that crosses the edge there.
    """
    index, line, _ = members(first[chosen], (first + lines.support)[chosen])
    steps = np.arange(-_REACH_PX, _REACH_PX + 1)
    at = np.rint(points.sample_px[index]).astype(np.int64)
    along_u = points.along_u[index]
    column = at[:, :1] + np.where(along_u[:, None], steps, 0)
    row = at[:, 1:] + np.where(along_u[:, None], 0, steps)
    height, width = light.shape
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    way = lines.direction[chosen][line]
    offset_u = column - lines.centre_px[chosen][line][:, :1]
    offset_v = row - lines.centre_px[chosen][line][:, 1:]
    across = offset_u * way[:, 1:] - offset_v * way[:, :1]
    half = round(_REACH_PX / _BIN_PX)
    place = np.rint(across / _BIN_PX).astype(np.int64) + half
    inside &= (place >= 0) & (place <= 2 * half)
    bins = 2 * half + 1
    key = (line[:, None] * bins + place)[inside]
    size = len(chosen) * bins
    count = np.bincount(key, minlength=size)
    level = light[row[inside], column[inside]]
    sums = (np.bincount(key, of, minlength=size) for of in (across[inside], level))
    mean_across, mean_level = ((total / np.maximum(count, 1)).reshape(-1, bins) for total in sums)
    return mean_across, mean_level, count.reshape(-1, bins)


def _fitted(
    across: Float[np.ndarray, "s b"],
    level: Float[np.ndarray, "s b"],
    count: Int[np.ndarray, "s b"],
    white: float,
    noise: Float[np.ndarray, "s 1"],
    blur: BlurPrior,
    tuning: SaturationTuning,
) -> tuple[np.ndarray, np.ndarray]:
    """(place, variance) of blurred steps across, by Gauss and Newton for all lines together."""
    width = np.exp(blur.log_width)
    seen = count > 0
    # From the dark side to where noise would first be clipped.
    top = white - _SIGMAS_BELOW_WHITE * noise
    near = (across > -2 * width - 1) & seen
    clipped = near & (level >= top)
    cut = np.where(clipped, across, np.inf).min(axis=1, keepdims=True)
    # The bin before holds pixels that are clipped, too, where the edge is steep.
    used = (
        seen & (across < cut - 1.5 * _BIN_PX) & (across > np.minimum(cut, 0) - _WIDTHS * width - 1)
    )
    # A line all of whose levels are near white has none to fit, and is poor below.
    floor = np.where(used, level, white).min(axis=1)
    visible = np.maximum(white - floor, 1.0)
    information = _information(used, count, noise, visible, tuning)
    prior = np.stack([np.zeros_like(floor), np.full_like(floor, tuning.log_above), floor,
                      np.full_like(floor, blur.log_width)], axis=-1)  # fmt: skip
    weight = np.array([0.0, 1 / tuning.log_above_sigma**2, 0.0, 1 / blur.sigma**2])
    start = np.tile(prior, (len(_STARTS), 1, 1))
    # Where the visible step is half way, a higher one is so many widths before its middle.
    start[:, :, 0] = -width * ndtri(0.5 * np.exp(-_STARTS[:, None]))
    start[:, :, 1] = _STARTS[:, None]
    # All lines from all starts at once.
    across, level, information, visible, prior = (
        np.concatenate([each] * len(_STARTS))
        for each in (across, level, information, visible, prior)
    )
    fit = step_fit(across, level, information, visible, start.reshape(-1, 4), prior, weight, 0.0)
    place, _, variance, cost, misfit = (column.reshape(len(_STARTS), -1) for column in fit)
    # Starts that end alike are one answer; several answers count by how well they explain.
    share = np.exp(-0.5 * (cost - cost.min(axis=0)))
    share = share / share.sum(axis=0)
    shift = (share * place).sum(axis=0)
    between = (share * np.square(place - shift)).sum(axis=0)
    freedom = np.maximum(used.sum(axis=1) - len(weight), 1)
    variance = (share * variance).sum(axis=0) * np.maximum(misfit.min(axis=0) / freedom, 1.0)
    variance = variance + between + np.square(tuning.shift_share * shift)
    poor = (used.sum(axis=1) < _LEAST_BINS) | ~(np.abs(shift) < _MOST_WIDTHS * width)
    return (
        np.where(poor, 0.0, shift),
        np.where(poor, np.square(tuning.unfitted_widths * width), variance),
    )
