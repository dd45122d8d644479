"""One lattice of blobs read as the sheet: rings, labels, and every circle measured."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detect.blobs import Blobs
from trinoc.calib.detect.ellipse_fit import Ellipses, refine_ellipses, start_ellipses
from trinoc.calib.detect.ellipse_pixels import pixels_round
from trinoc.calib.detect.ellipse_shape import smallest_axis
from trinoc.calib.detect.labels import label_circles
from trinoc.calib.detect.lattice import Lattice
from trinoc.calib.detect.layout import Layout
from trinoc.calib.detect.light import light_slope
from trinoc.calib.detect.line_shade import without_lines
from trinoc.calib.detect.picture import GreyPicture
from trinoc.calib.detect.warp import Warp, fit_warp
from trinoc.calib.pattern import Pattern
from trinoc.errors import DetectionError

# Pixels of one circle that the first, coarse fit looks at, about.
_COARSE_PIXELS = 150
_OUTER_RADII = 1.45
_HOLE_SIGMA = 0.2
_FEWEST_CIRCLES = 6


class Sheet(NamedTuple):
    """The sheet in one picture.

    index : (k, m) pattern index of each circle, one row for each labelling left open.
    ellipses : (m,) the circles.
    warp : sheet in mm to picture.
    """

    index: Int[np.ndarray, "k m"]
    ellipses: Ellipses
    warp: Warp


def read_sheet(
    picture: GreyPicture, blobs: Blobs, lattice: Lattice, pattern: Pattern, layout: Layout
) -> Sheet:
    """Label a lattice and measure all circles of the pattern that the picture shows.

    Raises
    ------
    DetectionError : see `trinoc.calib.detect.labels.label_circles`; or too few circles of
        the lattice are circles when looked at closely.
    """
    cell = lattice.cell.astype(float)
    centres = blobs.centres_px[lattice.blob]
    unit_radius = _lattice_radius(layout, len(lattice))
    warp = fit_warp(cell, centres)
    _, shape = warp.ellipses(cell, unit_radius)
    found_area = np.sqrt(np.linalg.det(blobs.shape_px2[lattice.blob]))
    swelling = np.median(found_area / np.sqrt(np.linalg.det(shape)))
    coarse = _coarse_fit(picture, centres, shape * swelling, layout.hole_ratio)
    good = _plausible(coarse, centres, shape, picture.noise_sigma)
    if np.sum(good) < _FEWEST_CIRCLES:
        raise DetectionError(
            f"No sheet of the pattern {pattern.name!r} was found in the picture; see that it"
            " lies flat, in focus, and large enough."
        )
    coarse, cell = coarse.take(good), lattice.cell[good]
    labelling = label_circles(cell, _ring_evidence(coarse, layout), pattern, layout)
    on_pattern = labelling.choices[0] >= 0
    index, coarse = labelling.choices[0][on_pattern], coarse.take(on_pattern)
    ellipses, index, warp = _measure_all(picture, coarse, index, pattern, layout)
    if len(index) < _FEWEST_CIRCLES:
        raise DetectionError(
            f"Only {len(index)} circles of the pattern {pattern.name!r} can be measured; show"
            f" at least {_FEWEST_CIRCLES} of them whole."
        )
    choices = _upright_first(labelling.permute(index), ellipses.centres_px, pattern)
    taken = choices[0]
    if not np.array_equal(taken, index):
        centres_mm, radius_mm = pattern.centres_mm[taken], pattern.radius_mm[taken]
        warp = fit_warp(centres_mm, ellipses.centres_px, radius_mm)
    return Sheet(choices, ellipses, warp)


def shows_same_sheet(first: Sheet, second: Sheet, pattern: Pattern) -> bool:
    """Whether two readings of a picture are of one sheet, split by a shadow or a hand, say."""
    index = second.index[0]
    centre, shape = first.warp.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    off = second.ellipses.centres_px - centre
    miss2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(shape), off)
    return bool(np.nanmedian(miss2) < 1.0)


def _upright_first(
    choices: Int[np.ndarray, "k m"], centres_px: Float[np.ndarray, "m 2"], pattern: Pattern
) -> Int[np.ndarray, "k m"]:
    """The labelling in which X points most to the right goes first."""
    relative = centres_px - centres_px.mean(axis=0)
    rightward = []
    for index in choices:
        on_sheet = pattern.centres_mm[index] - pattern.centres_mm[index].mean(axis=0)
        affine, *_ = np.linalg.lstsq(on_sheet, relative, rcond=None)
        rightward.append(affine[0, 0] / np.linalg.norm(affine[0]))
    return choices[np.argsort(-np.array(rightward), kind="stable")]


def _lattice_radius(layout: Layout, count: int) -> Float[np.ndarray, "n"]:
    return np.full(count, 1.0 / layout.extent)


def _coarse_fit(
    picture: GreyPicture,
    centres_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    hole_ratio: float,
) -> Ellipses:
    """Fit with whole circles, holes included, on a part of their pixels."""
    count = len(centres_px)
    area = np.pi * _OUTER_RADII**2 * np.sqrt(np.median(np.linalg.det(shape_px2)))
    step = max(1, int(np.sqrt(area / _COARSE_PIXELS)))
    pixels = pixels_round(
        picture.grey,
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
        noise_sigma=picture.noise_sigma,
        outlier_shares=(0.5, 0.25),
    )


def _fine_fit(
    picture: GreyPicture,
    coarse: Ellipses,
    index: Int[np.ndarray, "n"],
    pattern: Pattern,
    layout: Layout,
    warp: Warp,
) -> Ellipses:
    """Fit with all pixels of a band round the outer edge."""
    slope, slope_sigma = light_slope(coarse.centres_px, coarse.paper)
    start = coarse._replace(hole=pattern.is_ring[index].astype(float), slope=slope)
    band = (2.6 * coarse.blur_px + 0.7) / smallest_axis(coarse.shape_px2)
    halfway = 0.5 * (1.0 + layout.hole_ratio) if layout.hole_ratio > 0 else 0.3
    outer = np.clip(1.0 + band, 1.1, _OUTER_RADII)
    pixels = pixels_round(
        picture.grey,
        coarse.centres_px,
        coarse.shape_px2,
        np.clip(1.0 - band, halfway, 0.9),
        outer,
    )
    return refine_ellipses(
        without_lines(pixels, start, index, pattern, warp, outer),
        start,
        hole_ratio=layout.hole_ratio,
        free_hole=False,
        slope_sigma=slope_sigma,
        noise_sigma=picture.noise_sigma,
        outlier_shares=(0.08,),
    )


def _measure_all(
    picture: GreyPicture,
    coarse: Ellipses,
    index: Int[np.ndarray, "m"],
    pattern: Pattern,
    layout: Layout,
) -> tuple[Ellipses, Int[np.ndarray, "k"], Warp]:
    """Look for the circles that the blobs missed, then measure all together."""
    warp = fit_warp(pattern.centres_mm[index], coarse.centres_px, pattern.radius_mm[index])
    missing = np.setdiff1d(np.arange(len(pattern)), index)
    if len(missing):
        centre, shape = warp.ellipses(pattern.centres_mm[missing], pattern.radius_mm[missing])
        seen = _inside(centre, shape, picture.size_px)
        missing, centre, shape = missing[seen], centre[seen], shape[seen]
    if len(missing):
        extra = _coarse_fit(picture, centre, shape, layout.hole_ratio)
        like = _plausible(extra, centre, shape, picture.noise_sigma)
        like &= np.abs(extra.hole - pattern.is_ring[missing]) < 0.5
        contrast = (extra.paper * extra.ink) / np.median(coarse.paper * coarse.ink)
        like &= (contrast > 0.35) & (contrast < 3.0)
        coarse = _join(coarse, extra.take(like))
        index = np.concatenate([index, missing[like]])
    fine = _fine_fit(picture, coarse, index, pattern, layout, warp)
    centre, shape = warp.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    good = _plausible(fine, centre, shape, picture.noise_sigma)
    good &= _undisturbed(fine, picture.noise_sigma)
    agreeing, warp = _agreeing(fine, index, pattern)
    good &= agreeing
    return fine.take(good), index[good], warp


def _plausible(
    fitted: Ellipses,
    centre_px: Float[np.ndarray, "n 2"],
    shape_px2: Float[np.ndarray, "n 2 2"],
    noise_sigma: float,
) -> np.ndarray:
    """Whether a fit is a whole circle near the place and of the size that the lattice says."""
    off = fitted.centres_px - centre_px
    miss2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(shape_px2), off)
    area_ratio = np.sqrt(np.linalg.det(fitted.shape_px2) / np.linalg.det(shape_px2))
    area_ratio = area_ratio / np.median(area_ratio)
    contrast = fitted.paper * fitted.ink
    typical = np.median(contrast)
    relative = np.abs(fitted.residual_sigma / contrast)
    misfit = max(0.12, 1.6 * float(np.median(relative)))
    allowed = np.sqrt((1.6 * noise_sigma / contrast) ** 2 + misfit**2)
    return (
        np.isfinite(miss2)
        & (miss2 < 0.5**2)
        & (np.abs(np.log(area_ratio)) < np.log(1.5))
        & (contrast > 0.3 * typical)
        & (contrast < 3.0 * typical)
        & (fitted.kept > 0.8)
        & (relative < allowed)
    )


def _undisturbed(fitted: Ellipses, noise_sigma: float) -> np.ndarray:
    """Circles whose edge fits as well as is usual: none with a shadow's edge across it."""
    contrast = np.abs(fitted.paper * fitted.ink)
    beyond_noise = np.maximum(fitted.residual_sigma**2 - noise_sigma**2, 0.0)
    misfit = np.sqrt(beyond_noise) / contrast
    return misfit < 2.5 * np.median(misfit) + 0.02 + 0.6 * noise_sigma / contrast


def _agreeing(
    fitted: Ellipses, index: Int[np.ndarray, "m"], pattern: Pattern
) -> tuple[np.ndarray, Warp]:
    """Circles that lie where a smooth picture of the sheet puts them, and that picture."""
    good = np.ones(len(index), dtype=bool)
    own = np.sqrt(np.trace(fitted.covariance_px2, axis1=1, axis2=2))
    sharp = 0.03 * smallest_axis(fitted.shape_px2)
    centres_mm, radius_mm = pattern.centres_mm[index], pattern.radius_mm[index]
    warp = fit_warp(centres_mm, fitted.centres_px, radius_mm)
    for _ in range(2):
        centre, _ = warp.ellipses(centres_mm, radius_mm)
        off = fitted.centres_px - centre
        miss = np.sqrt(off[:, 0] ** 2 + off[:, 1] ** 2)
        before, good = good, miss < 5.0 * np.median(miss[good]) + 5.0 * own + sharp
        if np.array_equal(before, good) or np.sum(good) < _FEWEST_CIRCLES:
            break
        warp = fit_warp(centres_mm[good], fitted.centres_px[good], radius_mm[good])
    return good, warp


def _ring_evidence(fitted: Ellipses, layout: Layout) -> Float[np.ndarray, "n"]:
    """Log odds of ring against disc; nothing where the pattern has no rings."""
    if layout.hole_ratio == 0.0:
        return np.zeros(len(fitted.hole))
    hole = np.clip(fitted.hole, -0.3, 1.3)
    return (2.0 * hole - 1.0) / (2.0 * (fitted.hole_sigma**2 + _HOLE_SIGMA**2))


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
