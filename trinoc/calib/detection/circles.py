"""Detection of sheets: blobs to lattices, lattices to labelled and measured circles."""

from collections.abc import Iterator
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.calib.detection.blobs import Blobs, BlobScale, find_blobs
from trinoc.calib.detection.cross_lines import fit_cross_lines
from trinoc.calib.detection.detection import Detection, build_detection, rightward_cosine
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
    """A sheet located in one image, with m measured circles.

    Attributes
    ----------
    index : (k, m) pattern index of each circle, one row per possible labelling.
    ellipses : (m,) ellipses fitted to the circles.
    mapping : mapping from the sheet, mm, to the image, px.
    """

    index: Int[np.ndarray, "k m"]
    ellipses: Ellipses
    mapping: PlaneMapping


def detect_circles(
    image: Shaped[np.ndarray, "..."], pattern: Pattern, tuning: CalibTuning
) -> Detection:
    """Detect the circles and crossed lines of a sheet in one image.

    For details see `trinoc.calib.detection.registry.detect_pattern`.

    Parameters
    ----------
    image : grey or colour image.
    pattern : the sheet.
    tuning : tuned constants of calibration.

    Raises
    ------
    DetectionError : see `detect_pattern`.
    """
    search_input = search_image(image)
    symmetry = pattern_symmetry(pattern, tuning)
    failures: list[tuple[int, DetectionError]] = []
    # Dark circles on light paper, then light ones on dark.
    negative = search_input._replace(grey=search_input.grey.max() - search_input.grey)
    for positive in (search_input, negative):
        for blobs in _find_blobs_by_scale(positive, tuning):
            sheets = _find_sheets(positive, blobs, symmetry, failures, tuning)
            if len(sheets) > 1:
                raise DetectionError(
                    f"The image shows the sheet {pattern.name!r} more than once; show only one."
                )
            if sheets:
                return _as_detection(positive, sheets[0], pattern, tuning)
    if failures:
        # The largest lattice is most probably the sheet: report its failure.
        raise max(failures, key=lambda failure: failure[0])[1]
    raise _no_sheet_error(pattern)


def _no_sheet_error(pattern: Pattern) -> DetectionError:
    return DetectionError(
        f"No sheet of the pattern {pattern.name!r} was found in the image; check that the sheet is "
        "flat, uncovered, in focus, and large enough in the image."
    )


def circle_candidates(image: Shaped[np.ndarray, "..."], *, tuning: CalibTuning = TUNING) -> Blobs:
    """Dark regions of an image that could be circles of any pattern.

    Only the first scale of the search is used; `detect_pattern` also searches at other scales.

    Parameters
    ----------
    image : (height, width) or (height, width, channels) image.
    tuning : tuned constants of calibration.
    """
    return next(_find_blobs_by_scale(search_image(image), tuning))


def _find_blobs_by_scale(image: SearchImage, tuning: CalibTuning) -> Iterator[Blobs]:
    # Only the search uses a reduced image: circles are measured in the full image.
    factor = max(1, round(max(image.size_px) / tuning.detection.search_side_px))
    grey, noise = shrink_image(image, factor)
    *scales, enlarged_scale = (BlobScale(*scale) for scale in tuning.detection.blob_scales)
    for scale in scales:
        yield find_blobs(grey, noise, scale, tuning).rescale(factor)
    enlarged = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    yield find_blobs(enlarged, noise, enlarged_scale, tuning).rescale(0.5 * factor)


def _find_sheets(
    image: SearchImage,
    blobs: Blobs,
    symmetry: PatternSymmetry,
    failures: list[tuple[int, DetectionError]],
    tuning: CalibTuning,
) -> list[Sheet]:
    """Find all sheets among the blobs.

    failures : list to which the number of blobs and the error of each failed lattice are appended.
    """
    pattern, sheets = symmetry.pattern, list[Sheet]()
    for lattice in find_lattices(blobs, symmetry, tuning):
        try:
            sheet = _read_sheet(image, blobs, lattice, symmetry, tuning)
        except MirroredError:
            raise
        except DetectionError as failure:
            failures.append((len(lattice), failure))
            continue
        same_sheets = [other for other in sheets if _shows_same_sheet(other, sheet, pattern)]
        different = [other for other in sheets if not _shows_same_sheet(other, sheet, pattern)]
        sheets = [
            *different,
            max([*same_sheets, sheet], key=lambda candidate: len(candidate.index[0])),
        ]
    return sheets


def _read_sheet(
    image: SearchImage,
    blobs: Blobs,
    lattice: Lattice,
    symmetry: PatternSymmetry,
    tuning: CalibTuning,
) -> Sheet:
    """Label the circles of a lattice, and measure all visible circles of the pattern.

    Raises
    ------
    DetectionError : the circles cannot be labelled (see `label_circles`), or too few blobs are
        circles.
    """
    pattern, cell = symmetry.pattern, lattice.cell.astype(float)
    centres = blobs.centres_px[lattice.blob]
    unit_radius = np.full(len(lattice), 1.0 / symmetry.pitch_radii)
    mapping = fit_plane_mapping(cell, centres, tuning=tuning)
    _, shape = mapping.ellipses(cell, unit_radius)
    blob_area = np.sqrt(np.linalg.det(blobs.shape_px2[lattice.blob]))
    swelling = quick_median(blob_area / np.sqrt(np.linalg.det(shape)))
    coarse = fit_coarsely(image, centres, shape * swelling, symmetry.hole_ratio, tuning)
    is_plausible = are_plausible(coarse, centres, shape, image.noise_sigma)
    fewest = tuning.detection.fewest_places
    if np.sum(is_plausible) < fewest:
        raise _no_sheet_error(pattern)
    coarse, cell = coarse.take(is_plausible), lattice.cell[is_plausible]
    index = label_circles(cell, _ring_evidence(coarse, symmetry, tuning), symmetry, tuning)
    on_pattern = index >= 0
    ellipses, index, mapping = measure_circles(
        image, coarse.take(on_pattern), index[on_pattern], symmetry, tuning
    )
    if len(index) < fewest:
        count = f"Only {len(index)}" if len(index) else "None of the"
        raise DetectionError(
            f"Only {count} circles of the pattern {pattern.name!r} can be measured; show at least "
            f"{fewest} complete circles, without motion and in focus."
        )
    labellings = symmetry.symmetries[:, index]
    rightward = [rightward_cosine(ellipses.centres_px, pattern.centres_mm[k]) for k in labellings]
    labellings = labellings[np.argsort(-np.array(rightward), kind="stable")]
    first = labellings[0]
    if not np.array_equal(first, index):
        centres_mm, radius_mm = pattern.centres_mm[first], pattern.radius_mm[first]
        mapping = fit_plane_mapping(centres_mm, ellipses.centres_px, radius_mm, tuning=tuning)
    return Sheet(labellings, ellipses, mapping)


def _ring_evidence(
    fitted: Ellipses, symmetry: PatternSymmetry, tuning: CalibTuning
) -> Float[np.ndarray, "n"]:
    """Log odds that each circle is a ring and not a disc; 0 for a pattern without rings."""
    if symmetry.hole_ratio == 0.0:
        return np.zeros(len(fitted.hole))
    hole = np.clip(fitted.hole, -0.3, 1.3)
    return (2.0 * hole - 1.0) / (2.0 * (fitted.hole_sigma**2 + tuning.detection.hole_sigma**2))


def _shows_same_sheet(first: Sheet, second: Sheet, pattern: Pattern) -> bool:
    """True if two detected parts belong to one sheet, for example a sheet divided by a shadow."""
    if len(second.index[0]) > len(first.index[0]):
        # The larger part predicts the smaller one: few circles extrapolate poorly.
        first, second = second, first
    index = second.index[0]
    centre, shape = first.mapping.ellipses(pattern.centres_mm[index], pattern.radius_mm[index])
    deviation = second.ellipses.centres_px - centre
    squared_radii = np.einsum("ni,nij,nj->n", deviation, np.linalg.inv(shape), deviation)
    return bool(np.nanmedian(squared_radii) < 1.0)


def _as_detection(
    image: SearchImage, sheet: Sheet, pattern: Pattern, tuning: CalibTuning
) -> Detection:
    circles, size_px = sheet.ellipses, image.size_px
    lines = fit_cross_lines(
        image, pattern, sheet.mapping, float(quick_median(circles.blur_px)), tuning
    )
    return build_detection(
        sheet.index,
        circles.centres_px,
        circles.covariance_px2,
        size_px,
        circles.shape_px2,
        lines,
    )
