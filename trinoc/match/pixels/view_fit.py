"""What one picture says of the images of the lines that it shows, and where that cannot hold."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.geometry.intrinsics import Intrinsics
from trinoc.image.light import Light
from trinoc.match.pixels.images import LineImages
from trinoc.match.pixels.strip_fit import StripFit, fit_strips
from trinoc.match.pixels.strips import Strips, assign_pixels, sample_strips
from trinoc.match.pixels.tuning import PixelTuning
from trinoc.numerics.tails import MAD_TO_SIGMA

PIXELS = "pixels"
SHORT, NEIGHBOURS, FAINT = "too short", "neighbours", "too faint"
UNEVEN, MOVED = "no clean step", "another edge"
# The blur of a picture is found first, from this many of its longest lines and this guess, px.
# numerical: a start, which the fit leaves.
_FIRST_LINES, _FIRST_BLUR_PX, _FIRST_SIGMA = 32, 1.0, 0.5
# numerical: of fewer strips the guess stays.
_FEWEST = 6
# numerical: beside clipped pixels levels are not what they were before blur and noise, either.
_CLIPPED_PX = 2


class ViewFit(NamedTuple):
    """Of each line image, what holds of it.

    Fields
    ------
    words : (s,) PIXELS, or why the segment's place is kept.
    offset_px : (s, 2) at the line's ends: from the pixels, or the segment's own.
    covariance_px2 : (s, 2, 2) of these.
    widened_px2 : (s,) part of it that a profile which is too wide adds; it is the segment's, too.
    """

    words: Shaped[np.ndarray, "s"]
    offset_px: Float[np.ndarray, "s 2"]
    covariance_px2: Float[np.ndarray, "s 2 2"]
    widened_px2: Float[np.ndarray, "s"]


def fit_view(
    picture: Light,
    every_px: Float[np.ndarray, "n 2 2"],
    lens: Intrinsics,
    images: LineImages,
    tuning: PixelTuning,
) -> ViewFit:
    """Fit the images of lines to a picture; `every_px` are all segments, as they lie in it."""
    if len(images.track) == 0:
        none = np.zeros(0)
        return ViewFit(none.astype("<U1"), images.offset_px, images.covariance_px2, none)

    clipped, noise = picture.find_clipped(_CLIPPED_PX), picture.noise_sigma()

    def fit_some(of: LineImages, blur: float, sigma: float) -> tuple[Strips, StripFit]:
        reach = tuning.clear_widths * blur + tuning.clear_px
        owners = assign_pixels(every_px, lens.image_size_px, reach)
        strips = sample_strips(picture.light, clipped, owners, lens, of, blur, tuning)
        known = float(np.log(blur)), sigma
        return strips, fit_strips(strips, of.offset_px, noise, known, tuning)

    span = np.diff(images.extent_px, axis=1)[:, 0]
    longest = np.sort(np.argsort(-span, kind="stable")[:_FIRST_LINES])
    few = LineImages(*(column[longest] for column in images))
    _, first = fit_some(few, _FIRST_BLUR_PX, _FIRST_SIGMA)
    usual, _ = _usual_blur(first, np.log(_FIRST_BLUR_PX), tuning)
    strips, found = fit_some(images, float(np.exp(usual)), tuning.blur_sigma)
    return _assess_lines(images, strips, found, usual, tuning)


def _usual_blur(found: StripFit, otherwise: float, tuning: PixelTuning) -> tuple[float, float]:
    """(median, robust deviation) of the logarithm of the blur, where strips know it."""
    known = (found.information[:, 2, 2] * tuning.known_blur**2 > 1) & (found.blocks > 1)
    if known.sum() < _FEWEST:
        return otherwise, 0.0
    log = found.place[known, 2]
    middle = float(np.median(log))
    return middle, float(MAD_TO_SIGMA * np.median(np.abs(log - middle)))


def _expected_widening(
    off: Float[np.ndarray, "s"], own: Float[np.ndarray, "s"], spread: float, tuning: PixelTuning
) -> Float[np.ndarray, "s"]:
    """Mean square of the widening that is to be expected where the blur is not known well."""
    least, most = tuning.hidden_widening
    typical = np.clip(spread**2 - np.median(own), least**2, most**2)
    share = typical / (typical + own)
    return share * own + np.square(share * off)


def _assess_lines(
    images: LineImages, strips: Strips, found: StripFit, guess: float, tuning: PixelTuning
) -> ViewFit:
    """Covariances with what the blocks' scatter and the blur add, and a word for each line."""
    inverse = np.linalg.inv(found.information + 1e-6 * np.eye(3))
    prior = tuning.prior_blocks
    scatter = (prior + found.scatter) / (prior + np.maximum(found.blocks - 2, 0.0))
    usual, spread = _usual_blur(found, guess, tuning)
    off, own = found.place[:, 2] - usual, np.clip(inverse[:, 2, 2], 1e-9, 1.0)
    widening = np.maximum(
        np.square(off) - own - max(spread, tuning.least_blur_spread) ** 2,
        _expected_widening(off, own, spread, tuning),
    )
    widened = np.square(tuning.widening_moves * np.exp(found.place[:, 2]))
    widened = widened * np.minimum(widening, tuning.most_widening**2)
    floor = (tuning.floor_px**2 + widened)[:, None, None] * np.ones((2, 2))
    covariance = inverse[:, :2, :2] * np.maximum(scatter, 1.0)[:, None, None] + floor

    # Where a segment says nothing of the places beyond it, neither is asked.
    share = images.extent_px / images.length_px[:, None]
    weight = np.stack([1 - share, share], axis=2)
    moved = np.abs((weight @ (found.place[:, :2] - images.offset_px)[..., None])[..., 0])
    own = np.einsum("sei,sij,sej->se", weight, images.covariance_px2, weight)
    most = tuning.most_moved_widths * np.exp(usual) + tuning.most_moved_sigmas * np.sqrt(own)
    known = np.einsum("sei,sij,sej->se", weight, inverse[:, :2, :2], weight)
    faint = (known > np.square(tuning.most_sigma_widths * np.exp(usual))).any(axis=1)
    typical = np.median(found.chi_square[found.blocks > 0]) if (found.blocks > 0).any() else 1.0
    uneven = (scatter > tuning.most_scatter) | (found.chi_square > tuning.most_chi * typical)
    uneven |= widening > tuning.most_widening**2
    number = np.bincount(strips.line, minlength=len(images.track))
    words = np.select(
        [
            number == 0,
            (found.blocks < 1) | (found.share <= tuning.least_share),
            faint,
            uneven,
            (moved > most).any(axis=1) | ~np.isfinite(covariance).all(axis=(1, 2)),
        ],
        [SHORT, NEIGHBOURS, FAINT, UNEVEN, MOVED],
        PIXELS,
    )
    good = words == PIXELS
    widened = np.where((number > 0) & (found.blocks > 0), widened, 0.0)
    kept = images.covariance_px2 + widened[:, None, None] * np.ones((2, 2))
    return ViewFit(
        words,
        np.where(good[:, None], found.place[:, :2], images.offset_px),
        np.where(good[:, None, None], covariance, kept),
        widened,
    )
