"""Position of edges with a saturated bright side, from the unsaturated part of the profile.

A clipped step appears shifted toward its dark side. Below white, the profile is still that of the
whole step. If the blur is known, its slope and height there give the position of the middle. Each
line's mean profile is fitted with a blurred step of unknown position, height, lower level and blur.
Priors are the blur of other edges of the image and the usual height of surfaces above white.
"""

from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from trinoc.image.light import Light
from trinoc.image.step_edge import fit_profiles
from trinoc.image.strip import list_pixels_across, take_levels
from trinoc.numerics.tables import take_rows
from trinoc.segments.nevatia_babu.edge_points import PyramidLevel, Runs
from trinoc.segments.nevatia_babu.errors import ErrorModel
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.side_slopes import Shifts
from trinoc.segments.tuning import DEFAULT, SaturationTuning

_BIN_PX = 0.25  # numerical: samples of a profile
# Half width of the profile, and of the part that measures the blur.
_HALF_WIDTH_PX, _CLEAR_HALF_WIDTH_PX = 9, 4.0  # numerical: size of a sample
_LEAST_BINS = 5  # numerical: one more than the unknowns
# Number of longest edges without saturation that measure the blur.
_REFERENCES = 40  # numerical: size of a sample


class Profiles(NamedTuple):
    """Mean grey-level profiles across s lines, in b bins of the distance from the line.

    Attributes
    ----------
    across_px : (s, b)
        Mean distance of the pixels in each bin from the line, positive toward the bright side.
    level : (s, b)
        Mean level of these pixels.
    count : (s, b)
        Number of these pixels.
    noise : (s,)
        Standard deviation of the level of one pixel.
    """

    across_px: Float[np.ndarray, "s b"]
    level: Float[np.ndarray, "s b"]
    count: Int[np.ndarray, "s b"]
    noise: Float[np.ndarray, "s"]

    def information(
        self, used: Bool[np.ndarray, "s b"], height: Float[np.ndarray, "s"], misfit: float
    ) -> Float[np.ndarray, "s b"]:
        """Return the inverse variance of each mean level, (s, b); 0 for bins that are not `used`.

        `height` is the height of each step. `misfit` is the model error as a share of the height.
        """
        noise_variance = self.noise[:, None] ** 2 / np.maximum(self.count, 1)
        return np.where(used, 1 / (noise_variance + np.square(misfit * height[:, None])), 0.0)


def shifts_of_saturated(
    fine: PyramidLevel,
    runs: Runs,
    lines: FittedLines,
    error_model: ErrorModel,
    tuning: SaturationTuning = DEFAULT.saturation,
) -> Shifts:
    """Compute the position corrections of lines whose bright side is mostly saturated.

    The corrections of other lines are 0.
    """
    picture = fine.picture
    shift, variance = np.zeros(len(lines.support)), np.zeros(len(lines.support))
    is_saturated = error_model.saturated > 0.5
    if not is_saturated.any():
        return Shifts(shift, variance)
    noise_of_light = fine.noise_sigma * lines.light_per_level
    rise = lines.contrast * lines.light_per_level
    clear = (error_model.saturated == 0) & (error_model.crowded < tuning.most_crowded)
    clear = np.flatnonzero(clear & (rise > tuning.clear_contrast * noise_of_light))
    longest = clear[np.argsort(-lines.support[clear], kind="stable")[:_REFERENCES]]
    references = np.zeros(len(is_saturated), dtype=bool)
    references[longest] = True
    blur = _blur_of_clear(
        _mean_profiles(picture, noise_of_light, runs, lines, references), rise[references], tuning
    )
    profiles = _mean_profiles(picture, noise_of_light, runs, lines, is_saturated)
    shift[is_saturated], variance[is_saturated] = _fit_positions(
        profiles, picture.light_of_white, blur, tuning
    )
    return Shifts(shift, variance)


class BlurPrior(NamedTuple):
    """Prior of the logarithm of the edges' blur width, px: mean and standard deviation.

    The width includes the blur by the pixel.
    """

    log_width: float
    sigma: float


def _blur_of_clear(
    profiles: Profiles, rise: Float[np.ndarray, "s"], tuning: SaturationTuning
) -> BlurPrior:
    """Estimate the blur prior from unsaturated edges: median and spread of their blur widths.

    `rise` is the height of each step. With few edges, the prior is a constant.
    """
    unknown = BlurPrior(float(np.log(tuning.unknown_blur_px)), tuning.unknown_spread)
    if len(rise) < tuning.least_edges:
        return unknown
    across, level, count, _ = profiles
    used = (count > 0) & (np.abs(across) < _CLEAR_HALF_WIDTH_PX)
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
    selected: Bool[np.ndarray, "r"],
) -> Profiles:
    """Compute the mean grey-level profiles of the selected lines.

    At each point, the profile consists of pixels of the image row or column that crosses the edge.
    """
    selected_runs, lines = runs.take(selected), take_rows(lines, selected)
    line = selected_runs.spread(np.arange(len(lines.support)))
    middle_pixel = np.rint(selected_runs.points.sample_px).astype(np.int64)
    pixels = list_pixels_across(middle_pixel, selected_runs.points.along_u, _HALF_WIDTH_PX)
    level, inside = take_levels(picture.light, pixels)
    direction = lines.direction[line]
    offset_u, offset_v = np.moveaxis(pixels - lines.centre_px[line][:, None], -1, 0)
    across = offset_u * direction[:, 1:] - offset_v * direction[:, :1]
    half = round(_HALF_WIDTH_PX / _BIN_PX)
    bin_index = np.rint(across / _BIN_PX).astype(np.int64) + half
    inside &= (bin_index >= 0) & (bin_index <= 2 * half)
    bins = 2 * half + 1
    key = (line[:, None] * bins + bin_index)[inside]
    size = len(lines.support) * bins
    count = np.bincount(key, minlength=size)
    sums = (np.bincount(key, values[inside], minlength=size) for values in (across, level))
    mean_across, mean_level = ((total / np.maximum(count, 1)).reshape(-1, bins) for total in sums)
    return Profiles(mean_across, mean_level, count.reshape(-1, bins), noise[selected])


def _fit_positions(
    profiles: Profiles, white: float, blur: BlurPrior, tuning: SaturationTuning
) -> tuple[np.ndarray, np.ndarray]:
    """Fit a blurred step to the unsaturated part of each profile.

    Returns the position of the step across the line, (s,) px, and its variance. `white` is the
    saturation level.
    """
    across, level, count, noise = profiles
    width = np.exp(blur.log_width)
    has_pixels = count > 0
    # From the dark side up to the first bin where noise would be clipped.
    top = white - tuning.white_sigmas * noise[:, None]
    is_near = (across > -2 * width - 1) & has_pixels
    clipped = is_near & (level >= top)
    cut = np.where(clipped, across, np.inf).min(axis=1, keepdims=True)
    # On a steep edge, the bin before that contains clipped pixels as well.
    used = (
        has_pixels
        & (across < cut - 1.5 * _BIN_PX)
        & (across > np.minimum(cut, 0) - tuning.fit_widths * width - 1)
    )
    # A line with all levels near white has no level to fit; it is rejected below.
    floor = np.where(used, level, white).min(axis=1)
    visible = np.maximum(white - floor, 1.0)
    information = profiles.information(used, visible, tuning.misfit)
    prior = np.stack([np.zeros_like(floor), np.full_like(floor, tuning.log_above), floor,
                      np.full_like(floor, blur.log_width)], axis=-1)  # fmt: skip
    precision = np.array([0.0, 1 / tuning.log_above_sigma**2, 0.0, 1 / blur.sigma**2])
    start = prior.copy()
    # Start: half of the visible step is this many widths before the middle of the true step.
    start[:, 0] = -width * scipy.special.ndtri(0.5 * np.exp(-tuning.log_above))
    fit = fit_profiles(across, level, information, visible, start, prior, precision, 0.0)
    freedom = np.maximum(used.sum(axis=1) - len(precision), 1)
    variance = fit.variance_px2 * np.maximum(fit.chi_square / freedom, 1.0)
    shift = fit.position_px
    variance = variance + np.square(tuning.shift_share * shift)
    is_valid = np.maximum(np.abs(shift), np.sqrt(variance)) < tuning.fit_widths * width
    is_poor = (used.sum(axis=1) < _LEAST_BINS) | ~is_valid
    return (
        np.where(is_poor, 0.0, shift),
        np.where(is_poor, np.square(width), variance),
    )
