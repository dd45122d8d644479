"""Every circle of a labelled sheet measured, those that the search missed included."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.ellipse_fit import Ellipses, refine_ellipses, start_ellipses
from trinoc.calib.detection.ellipse_pixels import pixels_round
from trinoc.calib.detection.ellipse_shape import smallest_axis
from trinoc.calib.detection.grey import SearchImage, reduced
from trinoc.calib.detection.illumination import light_slope
from trinoc.calib.detection.line_interference import without_line_interference
from trinoc.calib.detection.pattern_symmetry import PatternSymmetry
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.detection.quality_gate import agreeing, plausible, undisturbed
from trinoc.calib.detection.quick_median import quick_median
from trinoc.calib.targets import Pattern

# Pixels of one circle that the first, coarse fit looks at, about.
_COARSE_PIXELS = 150
_OUTER_RADII = 1.45
_SETTLED_BLUR = 0.25
_MOST_REPEATS = 4


def coarse_fit(
    image: SearchImage,
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
) -> Ellipses:
    """Fit with whole circles, holes included, on a part of their pixels."""
    count = len(centres_px)
    area = np.pi * _OUTER_RADII**2 * np.sqrt(quick_median(np.linalg.det(shape_px2)))
    step = max(1, int(np.sqrt(area / _COARSE_PIXELS)))
    # Every n-th pixel of a large circle would miss its edge: a reduced picture does not.
    factor = max(1, step // 2)
    small, step = reduced(image, factor), step // factor
    centres_px, shape_px2 = (centres_px + 0.5) / factor - 0.5, shape_px2 / factor**2
    pixels = pixels_round(
        small.grey,
        centres_px,
        shape_px2,
        np.zeros(count),
        np.full(count, _OUTER_RADII),
        step=step,
    )
    return refine_ellipses(
        pixels,
        start_ellipses(
            pixels, centres_px, shape_px2, hole_ratio=hole_ratio, taken_share=1.0 / step**2
        ),
        hole_ratio=hole_ratio,
        free_hole=True,
        slope_sigma=None,
        noise_sigma=small.noise_sigma,
        outlier_shares=(0.5, 0.25),
    ).enlarged(factor)


def measure_all(
    image: SearchImage,
    coarse: Ellipses,
    index: Int[np.ndarray, "m"],
    pattern: Pattern,
    layout: PatternSymmetry,
) -> tuple[Ellipses, Int[np.ndarray, "k"], PlaneMapping]:
    """Look for the circles that the blobs missed, then measure all together."""
    warp = fit_plane_mapping(pattern.centres_mm[index], coarse.centres_px, pattern.radius_mm[index])
    missing = np.setdiff1d(np.arange(len(pattern)), index)
    if len(missing):
        centre, shape = warp.ellipses(pattern.centres_mm[missing], pattern.radius_mm[missing])
        seen = _inside(centre, shape, image.size_px)
        missing, centre, shape = missing[seen], centre[seen], shape[seen]
    if len(missing):
        extra = coarse_fit(image, centre, shape, layout.hole_ratio)
        like = plausible(extra, centre, shape, image.noise_sigma)
        like &= np.abs(extra.hole - pattern.is_ring[missing]) < 0.5
        contrast = (extra.paper * extra.ink) / quick_median(coarse.paper * coarse.ink)
        like &= (contrast > 0.35) & (contrast < 3.0)
        coarse = _join(coarse, extra.take(like))
        index = np.concatenate([index, missing[like]])
    fine = _settled(image, coarse, index, pattern, layout, warp)
    centre, shape = warp.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    good = plausible(fine, centre, shape, image.noise_sigma)
    good &= undisturbed(fine, image.noise_sigma)
    where_expected, warp = agreeing(fine, index, pattern)
    good &= where_expected
    return fine.take(good), index[good], warp


def _settled(
    image: SearchImage,
    coarse: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    layout: PatternSymmetry,
    warp: PlaneMapping,
) -> Ellipses:
    """Fine fits, again for those circles that moved too far for one step to be the last."""
    slope, slope_sigma = light_slope(coarse.centres_px, coarse.paper)
    before = coarse._replace(hole=pattern.is_ring[index].astype(float), slope=slope)
    fine = _fine_fit(image, before, index, pattern, layout, warp, slope_sigma)
    moving = np.arange(len(index))
    for _ in range(_MOST_REPEATS):
        now = fine.take(moving)
        moving = moving[_moved(before, now)]
        if not len(moving):
            break
        before = fine.take(moving)
        again = _fine_fit(image, before, index[moving], pattern, layout, warp, slope_sigma[moving])
        for field, new in zip(fine, again, strict=True):
            field[moving] = new
    return fine


def _moved(before: Ellipses, now: Ellipses) -> np.ndarray:
    """Whether the step was so long that what it left exceeds the circle's own sigma.

    A step of length s over an edge of blur b leaves about s^2 / b.
    """
    centre = np.abs(now.centres_px - before.centres_px).max(axis=1)
    axes = [np.sqrt(each.shape_px2[:, [0, 1], [0, 1]]) for each in (before, now)]
    blur = np.abs(now.blur_px / before.blur_px - 1.0)
    edge = np.maximum(centre, np.abs(axes[1] - axes[0]).max(axis=1))
    own = np.sqrt(np.trace(now.covariance_px2, axis1=1, axis2=2))
    return (edge**2 > now.blur_px * own) | (blur > _SETTLED_BLUR)


def _fine_fit(
    image: SearchImage,
    start: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    layout: PatternSymmetry,
    warp: PlaneMapping,
    slope_sigma: Float[np.ndarray, "n"],
) -> Ellipses:
    """Fit with all pixels of a band round the outer edge."""
    band = (2.6 * start.blur_px + 0.7) / smallest_axis(start.shape_px2)
    halfway = 0.5 * (1.0 + layout.hole_ratio) if layout.hole_ratio > 0 else 0.3
    outer = np.clip(1.0 + band, 1.1, _OUTER_RADII)
    pixels = pixels_round(
        image.grey,
        start.centres_px,
        start.shape_px2,
        np.clip(1.0 - band, halfway, 0.9),
        outer,
    )
    return refine_ellipses(
        without_line_interference(pixels, start, index, pattern, warp, outer),
        start,
        hole_ratio=layout.hole_ratio,
        free_hole=False,
        slope_sigma=slope_sigma,
        noise_sigma=image.noise_sigma,
        outlier_shares=(0.08,),
    )


def _inside(
    centre_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    size_px: tuple[int, int],
) -> np.ndarray:
    half = 1.1 * np.sqrt(np.maximum(shape_px2[:, [0, 1], [0, 1]], 0.0))
    low, high = centre_px - half, centre_px + half
    real = np.all(np.isfinite(centre_px), axis=1)
    real &= (np.linalg.det(np.where(real[:, None, None], shape_px2, 0.0)) > 1.0) & (
        shape_px2[:, 0, 0] > 0
    )
    return real & np.all((low > 0) & (high < np.array(size_px) - 1), axis=1)


def _join(first: Ellipses, second: Ellipses) -> Ellipses:
    return Ellipses(*(np.concatenate(pair) for pair in zip(first, second, strict=True)))
