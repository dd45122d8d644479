"""The search for a sheet: blobs to lattices, lattices to labelled and measured circles."""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.calib.detection.blobs import Blobs, BlobScale, find_blobs
from trinoc.calib.detection.cross_lines import fit_cross_lines
from trinoc.calib.detection.detection import Detection, build_detection, rightward_share
from trinoc.calib.detection.ellipse_fit import Ellipses
from trinoc.calib.detection.ellipse_pixels import quick_median
from trinoc.calib.detection.labels import (
    MirroredError,
    PatternSymmetry,
    label_circles,
    pattern_symmetry,
)
from trinoc.calib.detection.lattice import Lattice, find_lattices
from trinoc.calib.detection.measure_circles import fit_coarsely, measure_circles
from trinoc.calib.detection.plane_mapping import PlaneMapping, fit_plane_mapping
from trinoc.calib.detection.quality_gate import are_plausible
from trinoc.calib.detection.search_image import SearchImage, search_image, shrink_image
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import DetectionError


class Sheet(NamedTuple):
    """The sheet in one picture.

    index : (k, m) pattern index of each circle, one row for each labelling left open.
    ellipses : (m,) the circles.
    mapping : sheet in mm to picture.
    """

    index: Int[np.ndarray, "k m"]
    ellipses: Ellipses
    mapping: PlaneMapping


def detect_circles(
    image: Shaped[np.ndarray, "..."], pattern: Pattern, tuning: CalibTuning
) -> Detection:
    """The circles and crossed lines of a sheet in one picture: see `detect_pattern`."""
    picture = search_image(image)
    symmetry = pattern_symmetry(pattern, tuning)
    refusals: list[tuple[int, DetectionError]] = []
    # Dark circles on light paper, then light ones on dark.
    negative = picture._replace(grey=picture.grey.max() - picture.grey)
    for positive in (picture, negative):
        for blobs in _find_blobs_by_scale(positive, tuning):
            sheets = _find_sheets(positive, blobs, symmetry, refusals, tuning)
            if len(sheets) > 1:
                raise DetectionError(
                    f"The picture shows the sheet {pattern.name!r} more than once; leave one in"
                    " view."
                )
            if sheets:
                return _as_detection(positive, sheets[0], pattern, tuning)
    if refusals:
        # The largest lattice is likeliest to be the sheet, so its refusal says most.
        raise max(refusals, key=lambda refusal: refusal[0])[1]
    raise _nothing_found(pattern)


def _nothing_found(pattern: Pattern) -> DetectionError:
    return DetectionError(
        f"No sheet of the pattern {pattern.name!r} was found in the picture; see that it lies"
        " flat, uncovered, in focus, and large enough."
    )


def circle_candidates(image: Shaped[np.ndarray, "..."], *, tuning: CalibTuning = TUNING) -> Blobs:
    """Dark regions of a picture that could be circles, whatever the pattern.

    image : as of `detect_pattern`, which searches at other scales too where these are no sheet.
    """
    return next(_find_blobs_by_scale(search_image(image), tuning))


def _find_blobs_by_scale(picture: SearchImage, tuning: CalibTuning) -> Iterator[Blobs]:
    # Circles are measured in the whole picture, whatever its size.
    factor = max(1, round(max(picture.size_px) / tuning.detection.search_side_px))
    grey, noise = shrink_image(picture, factor)
    *scales, of_doubled = (BlobScale(*each) for each in tuning.detection.blob_scales)
    for scale in scales:
        yield find_blobs(grey, noise, scale, tuning).rescale(factor)
    doubled = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    yield find_blobs(doubled, noise, of_doubled, tuning).rescale(0.5 * factor)


def _find_sheets(
    picture: SearchImage,
    blobs: Blobs,
    symmetry: PatternSymmetry,
    refusals: list[tuple[int, DetectionError]],
    tuning: CalibTuning,
) -> list[Sheet]:
    """All sheets among the blobs; what was refused is added to `refusals`."""
    pattern, sheets = symmetry.pattern, list[Sheet]()
    for lattice in find_lattices(blobs, symmetry, tuning):
        try:
            sheet = _read_sheet(picture, blobs, lattice, symmetry, tuning)
        except MirroredError:
            raise
        except DetectionError as refusal:
            refusals.append((len(lattice), refusal))
            continue
        same = [known for known in sheets if _shows_same_sheet(known, sheet, pattern)]
        apart = [known for known in sheets if not _shows_same_sheet(known, sheet, pattern)]
        sheets = [*apart, max([*same, sheet], key=lambda each: len(each.index[0]))]
    return sheets


def _read_sheet(
    image: SearchImage,
    blobs: Blobs,
    lattice: Lattice,
    symmetry: PatternSymmetry,
    tuning: CalibTuning,
) -> Sheet:
    """Label a lattice and measure all circles of the pattern that the picture shows.

    Raises
    ------
    DetectionError : see `label_circles`; or too few circles of the lattice are circles when looked
        at closely.
    """
    pattern, cell = symmetry.pattern, lattice.cell.astype(float)
    centres = blobs.centres_px[lattice.blob]
    unit_radius = np.full(len(lattice), 1.0 / symmetry.pitch_radii)
    mapping = fit_plane_mapping(cell, centres, tuning=tuning)
    _, shape = mapping.ellipses(cell, unit_radius)
    found_area = np.sqrt(np.linalg.det(blobs.shape_px2[lattice.blob]))
    swelling = quick_median(found_area / np.sqrt(np.linalg.det(shape)))
    coarse = fit_coarsely(image, centres, shape * swelling, symmetry.hole_ratio, tuning)
    good = are_plausible(coarse, centres, shape, image.noise_sigma)
    fewest = tuning.detection.fewest_places
    if np.sum(good) < fewest:
        raise _nothing_found(pattern)
    coarse, cell = coarse.take(good), lattice.cell[good]
    index = label_circles(cell, _ring_evidence(coarse, symmetry, tuning), symmetry, tuning)
    on_pattern = index >= 0
    ellipses, index, mapping = measure_circles(
        image, coarse.take(on_pattern), index[on_pattern], symmetry, tuning
    )
    if len(index) < fewest:
        count = f"Only {len(index)}" if len(index) else "None of the"
        raise DetectionError(
            f"{count} circles of the pattern {pattern.name!r} can be measured; show at least"
            f" {fewest} of them whole, at rest and in focus."
        )
    labellings = symmetry.symmetries[:, index]
    right = [rightward_share(ellipses.centres_px, pattern.centres_mm[each]) for each in labellings]
    labellings = labellings[np.argsort(-np.array(right), kind="stable")]
    first = labellings[0]
    if not np.array_equal(first, index):
        centres_mm, radius_mm = pattern.centres_mm[first], pattern.radius_mm[first]
        mapping = fit_plane_mapping(centres_mm, ellipses.centres_px, radius_mm, tuning=tuning)
    return Sheet(labellings, ellipses, mapping)


def _ring_evidence(
    fitted: Ellipses, symmetry: PatternSymmetry, tuning: CalibTuning
) -> Float[np.ndarray, "n"]:
    """Log odds of ring against disc; nothing where the pattern has no rings."""
    if symmetry.hole_ratio == 0.0:
        return np.zeros(len(fitted.hole))
    hole = np.clip(fitted.hole, -0.3, 1.3)
    return (2.0 * hole - 1.0) / (2.0 * (fitted.hole_sigma**2 + tuning.detection.hole_sigma**2))


def _shows_same_sheet(first: Sheet, second: Sheet, pattern: Pattern) -> bool:
    """Whether two lattices in a picture are of one sheet, split by a shadow or a hand, say."""
    if len(second.index[0]) > len(first.index[0]):
        # A few circles do not tell where all the others lie, so the larger reading predicts.
        first, second = second, first
    index = second.index[0]
    centre, shape = first.mapping.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    off = second.ellipses.centres_px - centre
    miss2 = np.einsum("ni,nij,nj->n", off, np.linalg.inv(shape), off)
    return bool(np.nanmedian(miss2) < 1.0)


def _as_detection(
    picture: SearchImage, sheet: Sheet, pattern: Pattern, tuning: CalibTuning
) -> Detection:
    circles, size_px = sheet.ellipses, picture.size_px
    lines = fit_cross_lines(
        picture, pattern, sheet.mapping, float(quick_median(circles.blur_px)), tuning
    )
    found = circles.centres_px, circles.covariance_px2, size_px, circles.shape_px2
    return build_detection(sheet.index, *found, lines)
