"""Precise measurement of all circles of a labelled sheet, including those missed by the search."""

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
    pixels_around,
    quick_median,
    smallest_axis,
)
from trinoc.calib.detection.labels import PatternSymmetry
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.detection.quality_gate import are_plausible, are_undisturbed, select_agreeing
from trinoc.calib.detection.search_image import SearchImage, shrink_image
from trinoc.calib.tuning.every_group import CalibTuning

# numerical: relative change of the blur below which a circle has converged, and iterations.
_BLUR_TOLERANCE, _MOST_REPEATS = 0.25, 4
# numerical: iterations; the fit has converged after these.
_LIGHT_REWEIGHTINGS = 3
# numerical: `outlier_shares` of `refine_ellipses` near convergence.
_OUTLIER_SHARE = 0.08
# numerical: a circle and its four neighbours.
_NEIGHBOURS = 5


def fit_coarsely(
    image: SearchImage,
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
    tuning: CalibTuning,
) -> Ellipses:
    """Fit ellipses to a sample of the pixels of each circle, and estimate their holes.

    Parameters
    ----------
    image : grey image with its noise.
    centres_px, shape_px2 : (n, 2), (n, 2, 2) approximate centres and shape matrices.
    hole_ratio : inner radius of the rings divided by the outer radius; 0 for a sheet without rings.
    tuning : tuned constants of calibration.
    """
    count, outer = len(centres_px), tuning.detection.outer_radii
    area = np.pi * outer**2 * np.sqrt(quick_median(np.linalg.det(shape_px2)))
    step = max(1, int(np.sqrt(area / tuning.detection.coarse_pixels)))
    # Large circles are sampled in a reduced image: single pixels far apart would miss the edge.
    factor = max(1, step // 2)
    small, step = shrink_image(image, factor), step // factor
    centres_px, shape_px2 = (centres_px + 0.5) / factor - 0.5, shape_px2 / factor**2
    pixels = pixels_around(
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
            pixels, centres_px, shape_px2, hole_ratio=hole_ratio, sampled_share=1.0 / step**2
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
    """Locate the circles that the blob search missed, then measure all circles precisely.

    Parameters
    ----------
    image : grey image with its noise.
    coarse : (m,) coarse ellipses of the labelled circles.
    index : (m,) pattern index of each labelled circle.
    symmetry : the pattern with its lattice.
    tuning : tuned constants of calibration.

    Returns
    -------
    (k,) accepted ellipses, (k,) their pattern indices, and the mapping from the sheet to the image.
    """
    pattern = symmetry.pattern
    mapping = fit_plane_mapping(
        pattern.centres_mm[index], coarse.centres_px, pattern.radius_mm[index], tuning=tuning
    )
    missing = np.setdiff1d(np.arange(len(pattern)), index)
    centre, shape = mapping.ellipses(pattern.centres_mm[missing], pattern.radius_mm[missing])
    inside = _are_inside(centre, shape, image.size_px)
    missing, centre, shape = missing[inside], centre[inside], shape[inside]
    if len(missing):
        extra = fit_coarsely(image, centre, shape, symmetry.hole_ratio, tuning)
        is_accepted = are_plausible(extra, centre, shape, image.noise_sigma)
        is_accepted &= np.abs(extra.hole - pattern.is_ring[missing]) < 0.5
        contrast = (extra.paper * extra.ink) / quick_median(coarse.paper * coarse.ink)
        is_accepted &= (contrast > 0.35) & (contrast < 3.0)
        coarse = coarse.concatenate(extra.take(is_accepted))
        index = np.concatenate([index, missing[is_accepted]])
    fine = _fit_finely(image, coarse, index, symmetry, mapping, tuning)
    centre, shape = mapping.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    is_accepted = are_plausible(fine, centre, shape, image.noise_sigma)
    is_accepted &= are_undisturbed(fine, image.noise_sigma)
    is_in_place, mapping = select_agreeing(fine, index, pattern, tuning)
    is_accepted &= is_in_place
    return fine.take(is_accepted), index[is_accepted], mapping


def _are_inside(
    centre_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    size_px: tuple[int, int],
) -> np.ndarray:
    """Mask of the ellipses that lie completely inside the image."""
    half = 1.1 * np.sqrt(np.maximum(shape_px2[:, [0, 1], [0, 1]], 0.0))
    low, high = centre_px - half, centre_px + half
    is_valid = np.all(np.isfinite(centre_px), axis=1)
    is_valid &= np.linalg.det(np.where(is_valid[:, None, None], shape_px2, 0.0)) > 1.0
    is_valid &= shape_px2[:, 0, 0] > 0
    return is_valid & np.all((low > 0) & (high < np.array(size_px) - 1), axis=1)


def _fit_finely(
    image: SearchImage,
    coarse: Ellipses,
    index: Int[np.ndarray, "n"],
    symmetry: PatternSymmetry,
    mapping: PlaneMapping,
    tuning: CalibTuning,
) -> Ellipses:
    """Fit ellipses to all pixels in a band around the outer edge of each circle.

    For most circles, one Gauss-Newton step is sufficient. A circle whose ellipse changes too much
    is fitted again.
    """
    pattern = symmetry.pattern
    clear = are_clear_of_lines(pattern, index, tuning)
    slope, slope_sigma = light_slope(coarse.centres_px, coarse.paper, clear, tuning)
    halfway = 0.5 * (1.0 + symmetry.hole_ratio) if symmetry.hole_ratio > 0 else 0.3

    def cut_pixels(start: Ellipses, rows: np.ndarray) -> EllipsePixels:
        band = (2.6 * start.blur_px + 0.7) / smallest_axis(start.shape_px2)
        outer = np.clip(1.0 + band, 1.1, tuning.detection.outer_radii)
        inner = np.clip(1.0 - band, halfway, 0.9)
        pixels = pixels_around(image.grey, start.centres_px, start.shape_px2, inner, outer)
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

    start = coarse._replace(hole=pattern.is_ring[index].astype(float), slope=slope)
    active = np.arange(len(index))
    fine = fit(start, active)
    for _ in range(_MOST_REPEATS):
        active = active[_has_moved(start, fine.take(active))]
        if not len(active):
            break
        # The prior of the slope stays that of all circles, not the last estimate.
        start = fine.take(active)._replace(slope=slope[active])
        for field, refitted in zip(fine, fit(start, active), strict=True):
            field[active] = refitted
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


def _has_moved(before: Ellipses, after: Ellipses) -> np.ndarray:
    """Mask of the circles whose remaining error after a Gauss-Newton step exceeds their sigma.

    A step of length s at an edge with the blur b leaves an error of about s^2 / b.
    """
    centre = np.abs(after.centres_px - before.centres_px).max(axis=1)
    axes = [np.sqrt(ellipses.shape_px2[:, [0, 1], [0, 1]]) for ellipses in (before, after)]
    blur = np.abs(after.blur_px / before.blur_px - 1.0)
    edge = np.maximum(centre, np.abs(axes[1] - axes[0]).max(axis=1))
    sigma_px = np.sqrt(np.trace(after.covariance_px2, axis1=1, axis2=2))
    return (edge**2 > after.blur_px * sigma_px) | (blur > _BLUR_TOLERANCE)


def light_slope(
    centres_px: Float[np.ndarray, "n 2"],
    paper: Float[np.ndarray, "n"],
    clear: Bool[np.ndarray, "n"],
    tuning: CalibTuning,
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
    """Estimate the slope of the light at each circle.

    A quadratic surface through the grey levels of the paper around all circles is more precise than
    the pixels of one circle. Its error is independent of the error of the circle's centre. Near a
    shadow, the levels deviate from the surface. The sigma of the slope is this deviation divided by
    the distance of neighbouring circles.

    Parameters
    ----------
    centres_px : (n, 2) centres of the circles.
    paper : (n,) grey level of the paper around each circle.
    clear : (n,) mask of the circles whose paper is not darkened by a crossed line. Other circles
        are used only if too few are in the mask.
    tuning : tuned constants of calibration.

    Returns
    -------
    (n, 2) relative change of the light per pixel along x and y, and (n,) its standard deviation.
    """
    count, fewest = len(paper), tuning.detection.fewest_places
    if count < fewest:
        # Too few circles for an estimate.
        return np.zeros((count, 2)), np.zeros(count)
    if clear.sum() < fewest:
        clear = np.ones(count, dtype=bool)
    middle = centres_px.mean(axis=0)
    extent = max(float(np.abs(centres_px - middle).max()), 1.0)
    x, y = ((centres_px - middle) / extent).T
    one, zero = np.ones(count), np.zeros(count)
    terms = [one, x, y]
    terms_x, terms_y = [zero, one, zero], [zero, zero, one]
    # A quadratic has twice the unknowns of a plane and needs twice the circles.
    if clear.sum() >= 2 * fewest:
        terms += [x * x, x * y, y * y]
        terms_x += [2 * x, y, zero]
        terms_y += [zero, x, 2 * y]
    basis = np.stack(terms, axis=1)
    levels, rows = paper[clear], basis[clear]
    weight = np.ones(len(levels))
    for _ in range(_LIGHT_REWEIGHTINGS):
        surface, *_ = np.linalg.lstsq(rows * weight[:, None], levels * weight, rcond=None)
        deviation = np.abs(levels - rows @ surface)
        scale = 3.0 * quick_median(deviation) + 1e-9 * np.abs(levels).max() + 1e-30
        weight = 1.0 / (1.0 + (deviation / scale) ** 2)
    light = basis @ surface
    light = np.where(np.abs(light) > 1e-9, light, 1e-9)
    slope = np.stack([np.stack(terms_x, 1) @ surface, np.stack(terms_y, 1) @ surface], axis=1)
    distance = np.linalg.norm(centres_px[:, None] - centres_px[clear][None], axis=2)
    nearest = np.argsort(distance, axis=1)[:, :_NEIGHBOURS]
    spacing = np.sort(distance[clear], axis=1)[:, 1]
    relative = deviation / light[clear]
    slope_sigma = np.sqrt(np.mean(relative[nearest] ** 2, axis=1)) / quick_median(spacing)
    return slope / extent / light[:, None], slope_sigma
