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

from trinoc.image.light import Light
from trinoc.image.step_edge import fit_profiles
from trinoc.image.strip import list_pixels_across, take_levels
from trinoc.numerics.tables import take_rows
from trinoc.segments.nevatia_babu.accept import Shifts
from trinoc.segments.nevatia_babu.errors import ErrorModel
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.runs import PyramidLevel, Runs
from trinoc.segments.tuning import DEFAULT, SaturationTuning

_BIN_PX = 0.25  # numerical: samples of a profile
# The profile is looked at so far to both sides, and where its blur is measured so far.
_REACH_PX, _CLEAR_REACH_PX = 9, 4.0  # numerical: size of a sample
_LEAST_BINS = 5  # numerical: one more than the unknowns
# The blur comes from so many of the longest edges without saturation.
_REFERENCES = 40  # numerical: size of a sample


class Profiles(NamedTuple):
    """Mean levels across some lines, in bins: (s, b) each.

    across_px : toward the bright side. count : of pixels. noise : (s,) of one.
    """

    across_px: Float[np.ndarray, "s b"]
    level: Float[np.ndarray, "s b"]
    count: Int[np.ndarray, "s b"]
    noise: Float[np.ndarray, "s"]

    def information(
        self, used: Bool[np.ndarray, "s b"], height: Float[np.ndarray, "s"], misfit: float
    ) -> Float[np.ndarray, "s b"]:
        """One over the variance of the levels that are used, for steps of this height."""
        own = self.noise[:, None] ** 2 / np.maximum(self.count, 1)
        return np.where(used, 1 / (own + np.square(misfit * height[:, None])), 0.0)


def shifts_of_saturated(
    fine: PyramidLevel,
    runs: Runs,
    lines: FittedLines,
    disturbed: ErrorModel,
    tuning: SaturationTuning = DEFAULT.saturation,
) -> Shifts:
    """Fit the unsaturated part of each profile of which most is saturated; others stay."""
    picture = fine.picture
    shift, variance = np.zeros(len(lines.support)), np.zeros(len(lines.support))
    chosen = disturbed.saturated > 0.5
    if not chosen.any():
        return Shifts(shift, variance)
    noise_of_light = fine.noise_sigma * lines.light_per_level
    rise = lines.contrast * lines.light_per_level
    clear = (disturbed.saturated == 0) & (disturbed.crowded < tuning.most_crowded)
    clear = np.flatnonzero(clear & (rise > tuning.clear_contrast * noise_of_light))
    longest = clear[np.argsort(-lines.support[clear], kind="stable")[:_REFERENCES]]
    references = np.zeros(len(chosen), dtype=bool)
    references[longest] = True
    blur = _blur_of_clear(
        _mean_profiles(picture, noise_of_light, runs, lines, references), rise[references], tuning
    )
    profiles = _mean_profiles(picture, noise_of_light, runs, lines, chosen)
    shift[chosen], variance[chosen] = _places(profiles, picture.light_of_white, blur, tuning)
    return Shifts(shift, variance)


class BlurPrior(NamedTuple):
    """The width of the blur of a picture's edges, pixel included: logarithm and its deviation."""

    log_width: float
    sigma: float


def _blur_of_clear(
    profiles: Profiles, rise: Float[np.ndarray, "s"], tuning: SaturationTuning
) -> BlurPrior:
    """The blur that clear edges without saturation have, and how much it differs among them."""
    unknown = BlurPrior(float(np.log(tuning.unknown_blur_px)), tuning.unknown_spread)
    if len(rise) < tuning.least_edges:
        return unknown
    across, level, count, _ = profiles
    used = (count > 0) & (np.abs(across) < _CLEAR_REACH_PX)
    start = np.zeros((len(rise), 4))
    start[:, 2] = np.where(used, level, np.inf).min(axis=1)
    start[:, 3] = unknown.log_width
    precision = np.array([1.0, 1 / tuning.log_above_sigma**2, 0.0, 1 / unknown.sigma**2])
    information = profiles.information(used, rise, tuning.misfit)
    fit = fit_profiles(across, level, information, rise, start, start, precision, -np.inf)
    low, middle, high = np.quantile(fit.log_width, (0.16, 0.5, 0.84))
    return BlurPrior(float(middle), float(np.hypot((high - low) / 2, tuning.blur_spread)))


def _mean_profiles(
    picture: Light,
    noise: Float[np.ndarray, "r"],
    runs: Runs,
    lines: FittedLines,
    chosen: Bool[np.ndarray, "r"],
) -> Profiles:
    """Mean profiles of the chosen lines.

    Each point gives the pixels of the picture's row or column that crosses the edge there.
    """
    own, lines = runs.take(chosen), take_rows(lines, chosen)
    line = own.spread(np.arange(len(lines.support)))
    at = np.rint(own.points.sample_px).astype(np.int64)
    pixels = list_pixels_across(at, own.points.along_u, _REACH_PX)
    level, inside = take_levels(picture.light, pixels)
    way = lines.direction[line]
    offset_u, offset_v = np.moveaxis(pixels - lines.centre_px[line][:, None], -1, 0)
    across = offset_u * way[:, 1:] - offset_v * way[:, :1]
    half = round(_REACH_PX / _BIN_PX)
    place = np.rint(across / _BIN_PX).astype(np.int64) + half
    inside &= (place >= 0) & (place <= 2 * half)
    bins = 2 * half + 1
    key = (line[:, None] * bins + place)[inside]
    size = len(lines.support) * bins
    count = np.bincount(key, minlength=size)
    sums = (np.bincount(key, of[inside], minlength=size) for of in (across, level))
    mean_across, mean_level = ((total / np.maximum(count, 1)).reshape(-1, bins) for total in sums)
    return Profiles(mean_across, mean_level, count.reshape(-1, bins), noise[chosen])


def _places(
    profiles: Profiles, white: float, blur: BlurPrior, tuning: SaturationTuning
) -> tuple[np.ndarray, np.ndarray]:
    """(place, variance) of blurred steps across, from what is below white of them."""
    across, level, count, noise = profiles
    width = np.exp(blur.log_width)
    seen = count > 0
    # From the dark side to where noise would first be clipped.
    top = white - tuning.white_sigmas * noise[:, None]
    near = (across > -2 * width - 1) & seen
    clipped = near & (level >= top)
    cut = np.where(clipped, across, np.inf).min(axis=1, keepdims=True)
    # The bin before holds pixels that are clipped, too, where the edge is steep.
    used = (
        seen
        & (across < cut - 1.5 * _BIN_PX)
        & (across > np.minimum(cut, 0) - tuning.fit_widths * width - 1)
    )
    # A line all of whose levels are near white has none to fit, and is poor below.
    floor = np.where(used, level, white).min(axis=1)
    visible = np.maximum(white - floor, 1.0)
    information = profiles.information(used, visible, tuning.misfit)
    prior = np.stack([np.zeros_like(floor), np.full_like(floor, tuning.log_above), floor,
                      np.full_like(floor, blur.log_width)], axis=-1)  # fmt: skip
    precision = np.array([0.0, 1 / tuning.log_above_sigma**2, 0.0, 1 / blur.sigma**2])
    start = prior.copy()
    # Where the visible step is half way, a higher one is so many widths before its middle.
    start[:, 0] = -width * ndtri(0.5 * np.exp(-tuning.log_above))
    fit = fit_profiles(across, level, information, visible, start, prior, precision, 0.0)
    freedom = np.maximum(used.sum(axis=1) - len(precision), 1)
    variance = fit.variance_px2 * np.maximum(fit.chi_square / freedom, 1.0)
    shift = fit.place_px
    variance = variance + np.square(tuning.shift_share * shift)
    known = np.maximum(np.abs(shift), np.sqrt(variance)) < tuning.fit_widths * width
    poor = (used.sum(axis=1) < _LEAST_BINS) | ~known
    return (
        np.where(poor, 0.0, shift),
        np.where(poor, np.square(width), variance),
    )
