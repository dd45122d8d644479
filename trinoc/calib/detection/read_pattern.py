"""One lattice of blobs read as the sheet: rings, labels, and every circle measured."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.detection.blobs import Blobs
from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.grey import SearchImage
from trinoc.calib.detection.labels import label_circles
from trinoc.calib.detection.lattice import Lattice
from trinoc.calib.detection.measure_circles import coarse_fit, measure_all
from trinoc.calib.detection.pattern_symmetry import PatternSymmetry
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.detection.quality_gate import FEWEST_CIRCLES, plausible
from trinoc.calib.detection.quick_median import quick_median
from trinoc.calib.targets import Pattern
from trinoc.errors import DetectionError

# How far a fitted hole may be from 0 (disc) or 1 (ring), beyond its own sigma.
_HOLE_SIGMA = 0.2


class Sheet(NamedTuple):
    """The sheet in one picture.

    index : (k, m) pattern index of each circle, one row for each labelling left open.
    ellipses : (m,) the circles.
    warp : sheet in mm to picture.
    """

    index: Int[np.ndarray, "k m"]
    ellipses: Ellipses
    warp: PlaneMapping


def read_sheet(
    image: SearchImage, blobs: Blobs, lattice: Lattice, pattern: Pattern, layout: PatternSymmetry
) -> Sheet:
    """Label a lattice and measure all circles of the pattern that the picture shows.

    Raises
    ------
    DetectionError : see `trinoc.calib.detection.labels.label_circles`; or too few circles of
        the lattice are circles when looked at closely.
    """
    cell = lattice.cell.astype(float)
    centres = blobs.centres_px[lattice.blob]
    unit_radius = np.full(len(lattice), 1.0 / layout.pitch_radii)
    warp = fit_plane_mapping(cell, centres)
    _, shape = warp.ellipses(cell, unit_radius)
    found_area = np.sqrt(np.linalg.det(blobs.shape_px2[lattice.blob]))
    swelling = quick_median(found_area / np.sqrt(np.linalg.det(shape)))
    coarse = coarse_fit(image, centres, shape * swelling, layout.hole_ratio)
    good = plausible(coarse, centres, shape, image.noise_sigma)
    if np.sum(good) < FEWEST_CIRCLES:
        raise DetectionError(
            f"No sheet of the pattern {pattern.name!r} was found in the picture; see that it"
            " lies flat, in focus, and large enough."
        )
    coarse, cell = coarse.take(good), lattice.cell[good]
    labelling = label_circles(cell, _ring_evidence(coarse, layout), pattern, layout)
    on_pattern = labelling.choices[0] >= 0
    index, coarse = labelling.choices[0][on_pattern], coarse.take(on_pattern)
    ellipses, index, warp = measure_all(image, coarse, index, pattern, layout)
    if len(index) < FEWEST_CIRCLES:
        raise DetectionError(
            f"Only {len(index)} circles of the pattern {pattern.name!r} can be measured; show"
            f" at least {FEWEST_CIRCLES} of them whole."
        )
    choices = _upright_first(labelling.permute(index), ellipses.centres_px, pattern)
    taken = choices[0]
    if not np.array_equal(taken, index):
        centres_mm, radius_mm = pattern.centres_mm[taken], pattern.radius_mm[taken]
        warp = fit_plane_mapping(centres_mm, ellipses.centres_px, radius_mm)
    return Sheet(choices, ellipses, warp)


def shows_same_sheet(first: Sheet, second: Sheet, pattern: Pattern) -> bool:
    """Whether two readings of a picture are of one sheet, split by a shadow or a hand, say."""
    if len(second.index[0]) > len(first.index[0]):
        # A few circles do not tell where all the others lie, so the larger reading predicts.
        first, second = second, first
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


def _ring_evidence(fitted: Ellipses, layout: PatternSymmetry) -> Float[np.ndarray, "n"]:
    """Log odds of ring against disc; nothing where the pattern has no rings."""
    if layout.hole_ratio == 0.0:
        return np.zeros(len(fitted.hole))
    hole = np.clip(fitted.hole, -0.3, 1.3)
    return (2.0 * hole - 1.0) / (2.0 * (fitted.hole_sigma**2 + _HOLE_SIGMA**2))
