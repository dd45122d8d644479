"""Fit the images of lines in one view, and reject those that the model does not describe."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry.intrinsics import Intrinsics
from trinoc.image.light import Light
from trinoc.match.pixels.images import LineImages
from trinoc.match.pixels.strip_fit import StripFit, fit_strips
from trinoc.match.pixels.strips import Strips, sample_strips, segments_near_pixels
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.numerics.tails import MAD_TO_SIGMA

PIXELS = "pixels"
SHORT, NEIGHBOURS, FAINT = "too short", "neighbours", "too faint"
UNEVEN, MOVED = "no clean step", "another edge"
# numerical: the blur of an image is estimated first, from this number of its longest lines, with
# this initial value (px) and standard deviation of its logarithm.
_FIRST_LINES, _FIRST_BLUR_PX, _FIRST_SIGMA = 32, 1.0, 0.5
# numerical: with fewer strips, the initial blur stays.
_MIN_STRIPS = 6
# numerical: pixels this near to clipped ones are excluded, because blur mixes their levels.
_CLIPPED_PX = 2


class ViewFit(NamedTuple):
    """Positions of s line images in one view, from the pixels or from the segment.

    Attributes
    ----------
    outcome : (s,)
        PIXELS if the pixels are used, otherwise the reason why the segment is used.
    offset_px : (s, 2)
        Offset of the image at both ends of the line.
    covariance_px2 : (s, 2, 2)
        Covariance of the two offsets.
    widening_px2 : (s,)
        Part of each variance that allows for a second edge too close to be resolved. It is
        estimated from the width of the blurred step, and is part of the covariance of a segment
        too.
    """

    outcome: Shaped[np.ndarray, "s"]
    offset_px: Float[np.ndarray, "s 2"]
    covariance_px2: Float[np.ndarray, "s 2 2"]
    widening_px2: Float[np.ndarray, "s"]


def fit_view(
    light: Light,
    segments_px: Float[np.ndarray, "n 2 2"],
    lens: Intrinsics,
    images: LineImages,
    tuning: PixelTuning,
) -> ViewFit:
    """Fit the images of lines to the grey levels of one view.

    `segments_px` are the ends of all segments of the view, in distorted pixels. Pixels near other
    segments are not used.
    """
    if len(images.track) == 0:
        empty = np.zeros(0)
        return ViewFit(empty.astype("<U1"), images.offset_px, images.covariance_px2, empty)

    clipped, noise = light.find_clipped(_CLIPPED_PX), light.noise_sigma()

    def fit_some(line_images: LineImages, blur: float, sigma: float) -> tuple[Strips, StripFit]:
        radius = tuning.clear_widths * blur + tuning.clear_px
        near_segments = segments_near_pixels(segments_px, lens.image_size_px, radius)
        strips = sample_strips(light.light, clipped, near_segments, lens, line_images, blur, tuning)
        blur_prior = float(np.log(blur)), sigma
        return strips, fit_strips(strips, line_images.offset_px, noise, blur_prior, tuning)

    span = np.diff(images.extent_px, axis=1)[:, 0]
    longest = np.sort(np.argsort(-span, kind="stable")[:_FIRST_LINES])
    longest_images = LineImages(*(column[longest] for column in images))
    _, first_fit = fit_some(longest_images, _FIRST_BLUR_PX, _FIRST_SIGMA)
    log_blur, _ = _median_blur(first_fit, np.log(_FIRST_BLUR_PX), tuning)
    strips, fit = fit_some(images, float(np.exp(log_blur)), tuning.blur_sigma)
    return _assess_lines(images, strips, fit, log_blur, tuning)


def _median_blur(fit: StripFit, default: float, tuning: PixelTuning) -> tuple[float, float]:
    """Median and robust standard deviation of the logarithm of the blur, over lines that determine
    it.

    With few such lines, the result is (`default`, 0).
    """
    is_known = (fit.information[:, 2, 2] * tuning.precise_blur_sigma**2 > 1) & (fit.blocks > 1)
    if is_known.sum() < _MIN_STRIPS:
        return default, 0.0
    log_blur = fit.parameters[is_known, 2]
    median = float(np.median(log_blur))
    return median, float(MAD_TO_SIGMA * np.median(np.abs(log_blur - median)))


def _expected_widening(
    log_blur_offset: Float[np.ndarray, "s"],
    log_blur_variance: Float[np.ndarray, "s"],
    spread: float,
    tuning: PixelTuning,
) -> Float[np.ndarray, "s"]:
    """Expected squared widening of the blurred step, for lines whose blur is not well determined,
    (s,).

    The widening is the logarithm of the line's blur over the blur of the image. `spread` is its
    standard deviation among other lines.
    """
    smallest, largest = tuning.hidden_widening
    hidden_variance = np.clip(spread**2 - np.median(log_blur_variance), smallest**2, largest**2)
    share = hidden_variance / (hidden_variance + log_blur_variance)
    return share * log_blur_variance + np.square(share * log_blur_offset)


def _assess_lines(
    images: LineImages, strips: Strips, fit: StripFit, first_log_blur: float, tuning: PixelTuning
) -> ViewFit:
    """Decide for each line whether its pixels are used, and compute offsets and covariances.

    The covariance includes the scatter of the blocks and a possible second edge (`widening_px2`).
    """
    inverse = np.linalg.inv(fit.information + 1e-6 * np.eye(3))
    prior = tuning.prior_blocks
    scatter = (prior + fit.scatter) / (prior + np.maximum(fit.blocks - 2, 0.0))
    log_blur, spread = _median_blur(fit, first_log_blur, tuning)
    log_blur_offset = fit.parameters[:, 2] - log_blur
    log_blur_variance = np.clip(inverse[:, 2, 2], 1e-9, 1.0)
    widening = np.maximum(
        np.square(log_blur_offset) - log_blur_variance - max(spread, tuning.min_blur_spread) ** 2,
        _expected_widening(log_blur_offset, log_blur_variance, spread, tuning),
    )
    widening_px2 = np.square(tuning.shift_per_widening * np.exp(fit.parameters[:, 2]))
    widening_px2 = widening_px2 * np.minimum(widening, tuning.max_widening**2)
    floor = (tuning.floor_px**2 + widening_px2)[:, None, None] * np.ones((2, 2))
    covariance = inverse[:, :2, :2] * np.maximum(scatter, 1.0)[:, None, None] + floor

    # Positions are compared at the segment's ends, because it gives no information beyond them.
    share = images.extent_px / images.length_px[:, None]
    weight = np.stack([1 - share, share], axis=2)
    displacement_px = np.abs(
        (weight @ (fit.parameters[:, :2] - images.offset_px)[..., None])[..., 0]
    )
    segment_variance = np.einsum("sei,sij,sej->se", weight, images.covariance_px2, weight)
    limit_px = tuning.max_displacement_widths * np.exp(
        log_blur
    ) + tuning.max_displacement_sigmas * np.sqrt(segment_variance)
    end_variance = np.einsum("sei,sij,sej->se", weight, inverse[:, :2, :2], weight)
    is_faint = (end_variance > np.square(tuning.max_sigma_widths * np.exp(log_blur))).any(axis=1)
    median_chi_square = np.median(fit.chi_square[fit.blocks > 0]) if (fit.blocks > 0).any() else 1.0
    is_uneven = (scatter > tuning.max_scatter) | (
        fit.chi_square > tuning.max_chi * median_chi_square
    )
    is_uneven |= widening > tuning.max_widening**2
    block_count = np.bincount(strips.line, minlength=len(images.track))
    outcome = np.select(
        [
            block_count == 0,
            (fit.blocks < 1) | (fit.share <= tuning.min_share),
            is_faint,
            is_uneven,
            (displacement_px > limit_px).any(axis=1) | ~np.isfinite(covariance).all(axis=(1, 2)),
        ],
        [SHORT, NEIGHBOURS, FAINT, UNEVEN, MOVED],
        PIXELS,
    )
    is_measured = outcome == PIXELS
    widening_px2 = np.where((block_count > 0) & (fit.blocks > 0), widening_px2, 0.0)
    segment_covariance = images.covariance_px2 + widening_px2[:, None, None] * np.ones((2, 2))
    return ViewFit(
        outcome,
        np.where(is_measured[:, None], fit.parameters[:, :2], images.offset_px),
        np.where(is_measured[:, None, None], covariance, segment_covariance),
        widening_px2,
    )
