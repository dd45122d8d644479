"""Every circle of a labelled sheet measured, those that the search missed included."""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.detection.cross_lines import are_clear_of_lines, subtract_line_blur
from trinoc.calib.detection.ellipse_fit import (
    Ellipses,
    refine_ellipses,
    start_ellipses,
    with_window_noise,
)
from trinoc.calib.detection.ellipse_pixels import (
    EllipsePixels,
    pixels_round,
    quick_median,
    smallest_axis,
)
from trinoc.calib.detection.labels import PatternSymmetry
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.detection.quality_gate import are_plausible, are_undisturbed, select_agreeing
from trinoc.calib.detection.search_image import SearchImage, shrink_image
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: tolerance and steps of an iteration that converges.
_SETTLED_BLUR, _MOST_REPEATS = 0.25, 4
# numerical: of an iteration that converges.
_LIGHT_REWEIGHTINGS = 3
# numerical: as `refine_ellipses` has it, of fits that end.
_OUTLIER_SHARE = 0.08
# numerical: a circle and the four beside it.
_NEIGHBOURS = 5


def fit_coarsely(
    image: SearchImage,
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
    tuning: CalibTuning,
) -> Ellipses:
    """Ellipses fitted to whole circles, holes included, on a part of their pixels."""
    count, outer = len(centres_px), tuning.detection.outer_radii
    area = np.pi * outer**2 * np.sqrt(quick_median(np.linalg.det(shape_px2)))
    step = max(1, int(np.sqrt(area / tuning.detection.coarse_pixels)))
    # Every n-th pixel of a large circle would miss its edge: a reduced picture does not.
    factor = max(1, step // 2)
    small, step = shrink_image(image, factor), step // factor
    centres_px, shape_px2 = (centres_px + 0.5) / factor - 0.5, shape_px2 / factor**2
    pixels = pixels_round(
        small.grey,
        centres_px,
        shape_px2,
        np.zeros(count),
        np.full(count, outer),
        step=step,
    )
    return refine_ellipses(
        pixels,
        start_ellipses(
            pixels, centres_px, shape_px2, hole_ratio=hole_ratio, taken_share=1.0 / step**2
        ),
        hole_ratio=hole_ratio,
        slope_sigma=None,
        noise_sigma=small.noise_sigma,
        outlier_shares=(0.5, 0.25),
        tuning=tuning,
    ).rescale(factor)


def measure_circles(
    image: SearchImage,
    coarse: Ellipses,
    index: Int[np.ndarray, "m"],
    symmetry: PatternSymmetry,
    tuning: CalibTuning,
) -> tuple[Ellipses, Int[np.ndarray, "k"], PlaneMapping]:
    """Look for the circles that the blobs missed, then measure all together."""
    pattern = symmetry.pattern
    mapping = fit_plane_mapping(
        pattern.centres_mm[index], coarse.centres_px, pattern.radius_mm[index], tuning=tuning
    )
    missing = np.setdiff1d(np.arange(len(pattern)), index)
    centre, shape = mapping.ellipses(pattern.centres_mm[missing], pattern.radius_mm[missing])
    seen = _are_inside(centre, shape, image.size_px)
    missing, centre, shape = missing[seen], centre[seen], shape[seen]
    if len(missing):
        extra = fit_coarsely(image, centre, shape, symmetry.hole_ratio, tuning)
        like = are_plausible(extra, centre, shape, image.noise_sigma)
        like &= np.abs(extra.hole - pattern.is_ring[missing]) < 0.5
        contrast = (extra.paper * extra.ink) / quick_median(coarse.paper * coarse.ink)
        like &= (contrast > 0.35) & (contrast < 3.0)
        coarse = coarse.concatenate(extra.take(like))
        index = np.concatenate([index, missing[like]])
    fine = _fit_finely(image, coarse, index, symmetry, mapping, tuning)
    centre, shape = mapping.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    good = are_plausible(fine, centre, shape, image.noise_sigma)
    good &= are_undisturbed(fine, image.noise_sigma)
    where_expected, mapping = select_agreeing(fine, index, pattern, tuning)
    good &= where_expected
    return fine.take(good), index[good], mapping


def _are_inside(
    centre_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    size_px: tuple[int, int],
) -> np.ndarray:
    half = 1.1 * np.sqrt(np.maximum(shape_px2[:, [0, 1], [0, 1]], 0.0))
    low, high = centre_px - half, centre_px + half
    real = np.all(np.isfinite(centre_px), axis=1)
    real &= np.linalg.det(np.where(real[:, None, None], shape_px2, 0.0)) > 1.0
    real &= shape_px2[:, 0, 0] > 0
    return real & np.all((low > 0) & (high < np.array(size_px) - 1), axis=1)


def _fit_finely(
    image: SearchImage,
    coarse: Ellipses,
    index: Int[np.ndarray, "n"],
    symmetry: PatternSymmetry,
    mapping: PlaneMapping,
    tuning: CalibTuning,
) -> Ellipses:
    """Fits with all pixels of a band round the outer edge, again for those circles that moved too
    far for one step to be the last."""
    pattern = symmetry.pattern
    clear = are_clear_of_lines(pattern, index, tuning)
    slope, slope_sigma = light_slope(coarse.centres_px, coarse.paper, clear, tuning)
    halfway = 0.5 * (1.0 + symmetry.hole_ratio) if symmetry.hole_ratio > 0 else 0.3

    def cut_pixels(start: Ellipses, rows: np.ndarray) -> EllipsePixels:
        band = (2.6 * start.blur_px + 0.7) / smallest_axis(start.shape_px2)
        outer = np.clip(1.0 + band, 1.1, tuning.detection.outer_radii)
        inner = np.clip(1.0 - band, halfway, 0.9)
        pixels = pixels_round(image.grey, start.centres_px, start.shape_px2, inner, outer)
        return subtract_line_blur(pixels, start, index[rows], pattern, mapping, outer)

    def fit(start: Ellipses, rows: np.ndarray) -> Ellipses:
        return refine_ellipses(
            cut_pixels(start, rows),
            start,
            hole_ratio=symmetry.hole_ratio,
            slope_sigma=slope_sigma[rows],
            noise_sigma=image.noise_sigma,
            outlier_shares=(_OUTLIER_SHARE,),
            tuning=tuning,
        )

    before = coarse._replace(hole=pattern.is_ring[index].astype(float), slope=slope)
    moving = np.arange(len(index))
    fine = fit(before, moving)
    for _ in range(_MOST_REPEATS):
        now = fine.take(moving)
        moving = moving[_has_moved(before, now)]
        if not len(moving):
            break
        # What is known of the light stays what it was, not what the last fit made of it.
        before = fine.take(moving)._replace(slope=slope[moving])
        for field, new in zip(fine, fit(before, moving), strict=True):
            field[moving] = new
    return with_window_noise(
        fine,
        cut_pixels(fine, np.arange(len(index))),
        fine._replace(slope=slope),
        hole_ratio=symmetry.hole_ratio,
        slope_sigma=slope_sigma,
        noise_sigma=image.noise_sigma,
        outlier_share=_OUTLIER_SHARE,
        tuning=tuning,
    )


def _has_moved(before: Ellipses, now: Ellipses) -> np.ndarray:
    """Whether the step was so long that what it left exceeds the circle's own sigma.

    A step of length s over an edge of blur b leaves about s^2 / b.
    """
    centre = np.abs(now.centres_px - before.centres_px).max(axis=1)
    axes = [np.sqrt(each.shape_px2[:, [0, 1], [0, 1]]) for each in (before, now)]
    blur = np.abs(now.blur_px / before.blur_px - 1.0)
    edge = np.maximum(centre, np.abs(axes[1] - axes[0]).max(axis=1))
    own = np.sqrt(np.trace(now.covariance_px2, axis1=1, axis2=2))
    return (edge**2 > now.blur_px * own) | (blur > _SETTLED_BLUR)


def light_slope(
    centres_px: Float[np.ndarray, "n 2"],
    paper: Float[np.ndarray, "n"],
    clear: Bool[np.ndarray, "n"],
    tuning: CalibTuning,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Relative change of the paper's grey per pixel at each circle, and how sure it is.

    clear : circles whose paper is no darker than light makes it. Of others, as far as there are
        enough of these, the grey is not believed.

    A quadratic through the greys round all circles says more of the slope across one circle
    than its own pixels do, and costs its centre nothing. Where the greys do not lie on that
    surface, near a shadow, the slope is as unsure as they are over one pitch.
    """
    count, fewest = len(paper), tuning.detection.fewest_places
    if count < fewest:
        # Nothing is claimed of as few circles.
        return np.zeros((count, 2)), np.zeros(count)
    if clear.sum() < fewest:
        clear = np.ones(count, dtype=bool)
    middle = centres_px.mean(axis=0)
    extent = max(float(np.abs(centres_px - middle).max()), 1.0)
    x, y = ((centres_px - middle) / extent).T
    one, zero = np.ones(count), np.zeros(count)
    terms = [one, x, y]
    terms_x, terms_y = [zero, one, zero], [zero, zero, one]
    # Twice the unknowns of a plane, twice the circles.
    if clear.sum() >= 2 * fewest:
        terms += [x * x, x * y, y * y]
        terms_x += [2 * x, y, zero]
        terms_y += [zero, x, 2 * y]
    basis = np.stack(terms, axis=1)
    seen, rows = paper[clear], basis[clear]
    weight = np.ones(len(seen))
    for _ in range(_LIGHT_REWEIGHTINGS):
        surface, *_ = np.linalg.lstsq(rows * weight[:, None], seen * weight, rcond=None)
        miss = np.abs(seen - rows @ surface)
        scale = 3.0 * quick_median(miss) + 1e-9 * np.abs(seen).max() + 1e-30
        weight = 1.0 / (1.0 + (miss / scale) ** 2)
    light = basis @ surface
    light = np.where(np.abs(light) > 1e-9, light, 1e-9)
    slope = np.stack([np.stack(terms_x, 1) @ surface, np.stack(terms_y, 1) @ surface], axis=1)
    distance = np.linalg.norm(centres_px[:, None] - centres_px[clear][None], axis=2)
    nearest = np.argsort(distance, axis=1)[:, :_NEIGHBOURS]
    between = np.sort(distance[clear], axis=1)[:, 1]
    relative_miss = miss / light[clear]
    unsure = np.sqrt(np.mean(relative_miss[nearest] ** 2, axis=1)) / quick_median(between)
    return slope / extent / light[:, None], unsure
