"""The public search: a picture and a pattern to labelled circles and lines."""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Shaped

from trinoc.calib.detection.blobs import Blobs, Scale, find_blobs
from trinoc.calib.detection.cross_lines import fit_cross_lines
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.grey import SearchImage, reduced, search_image
from trinoc.calib.detection.labels import MirroredError
from trinoc.calib.detection.lattice import find_lattices
from trinoc.calib.detection.pattern_symmetry import PatternSymmetry, pattern_symmetry
from trinoc.calib.detection.quick_median import quick_median
from trinoc.calib.detection.read_pattern import Sheet, read_sheet, shows_same_sheet
from trinoc.calib.targets import Pattern
from trinoc.errors import DetectionError

_FEWEST_BLOBS = 6
# Blobs are sought in pictures of about this many pixels a side, circles measured in full.
_SEARCH_SIDE_PX = 1200


def detect_pattern(image: Shaped[np.ndarray, "..."], pattern: Pattern) -> Detection:
    """Circles and crossed lines of the sheet `pattern` in one picture.

    image : (height, width) or (height, width, channels), 8 or 16 bit or real numbers.

    Circles may be missing, covered, or cut by the border as long as the rings seen tell where
    the sheet lies. A pattern whose own symmetry leaves more than one labelling open (a plain
    grid of discs) is labelled as if X pointed right, as nearly as it can; the other choices
    stand in `Detection.ambiguity`.

    Raises
    ------
    InputError : `image` is no picture, or `pattern` has no plane lattice.
    DetectionError : no sheet is seen, or two, or a mirrored one, or another pattern, or too
        little of it to tell where it lies.
    """
    picture = search_image(image)
    layout = pattern_symmetry(pattern)
    refusals: list[tuple[int, DetectionError]] = []
    for positive in _both_polarities(picture):
        for blobs in _searches(positive):
            sheets = _sheets(positive, blobs, pattern, layout, refusals)
            if len(sheets) > 1:
                raise DetectionError(
                    f"The picture shows the sheet {pattern.name!r} more than once; leave one in"
                    " view."
                )
            if sheets:
                return _as_detection(positive, sheets[0], pattern)
    if refusals:
        # The largest lattice is likeliest to be the sheet, so its refusal says most.
        raise max(refusals, key=lambda refusal: refusal[0])[1]
    raise DetectionError(
        f"No sheet of the pattern {pattern.name!r} was found in the picture; see that it lies"
        " flat, in focus, and large enough."
    )


def circle_candidates(image: Shaped[np.ndarray, "..."]) -> Blobs:
    """Dark regions of a picture that could be circles, before any pattern is asked of them.

    image : as of `detect_pattern`, which looks in other ways too where these are no sheet.
    """
    return next(_searches(search_image(image)))


def _both_polarities(picture: SearchImage) -> Iterator[SearchImage]:
    """Dark circles on light paper, then light ones on dark."""
    yield picture
    yield picture._replace(grey=picture.grey.max() - picture.grey)


def _searches(picture: SearchImage) -> Iterator[Blobs]:
    """Blobs by one way of looking after another, the likeliest to succeed first."""
    factor = max(1, round(max(picture.size_px) / _SEARCH_SIDE_PX))
    grey, noise = reduced(picture, factor)
    for scale in (
        Scale(0.8, 8),
        Scale(0.8, 3),
        Scale(2.0, 8),
        Scale(0.8, 20),
        Scale(0.8, 8, opening_px=5),
        Scale(0.8, 8, closing_px=5),
        Scale(3.0, 20),
    ):
        yield _enlarged(find_blobs(grey, noise, scale), factor)
    doubled = cv2.resize(grey, None, fx=2, fy=2, interpolation=cv2.INTER_CUBIC)
    yield _enlarged(find_blobs(doubled, noise, Scale(1.2, 5)), 0.5 * factor)


def _enlarged(blobs: Blobs, factor: float) -> Blobs:
    """Blobs of a picture `factor` times smaller, in pixels of the large one."""
    middle = 0.5 * (factor - 1)
    return Blobs(blobs.centres_px * factor + middle, blobs.shape_px2 * factor**2)


def _sheets(
    picture: SearchImage,
    blobs: Blobs,
    pattern: Pattern,
    layout: PatternSymmetry,
    refusals: list[tuple[int, DetectionError]],
) -> list[Sheet]:
    """All sheets among the blobs; what was refused is added to `refusals`."""
    span = int(np.ptp(pattern.lattice, axis=0).max()) + 3
    sheets: list[Sheet] = []
    if len(blobs) < _FEWEST_BLOBS:
        return sheets
    for lattice in find_lattices(blobs, layout, at_least=_FEWEST_BLOBS, span=span):
        try:
            sheet = read_sheet(picture, blobs, lattice, pattern, layout)
        except MirroredError:
            raise
        except DetectionError as refusal:
            refusals.append((len(lattice), refusal))
            continue
        apart = [known for known in sheets if not shows_same_sheet(known, sheet, pattern)]
        same = [known for known in sheets if shows_same_sheet(known, sheet, pattern)]
        sheets = [*apart, max([*same, sheet], key=lambda each: len(each.index[0]))]
    return sheets


def _as_detection(picture: SearchImage, sheet: Sheet, pattern: Pattern) -> Detection:
    blur = float(quick_median(sheet.ellipses.blur_px))
    lines = fit_cross_lines(picture.grey, picture.noise_sigma, pattern, sheet.warp, blur)
    return Detection(
        circle_index=sheet.index[0],
        centres_px=sheet.ellipses.centres_px,
        covariance_px2=sheet.ellipses.covariance_px2,
        shape_px2=sheet.ellipses.shape_px2,
        lines_px=lines,
        image_size_px=picture.size_px,
        ambiguity=sheet.index[1:] if len(sheet.index) > 1 else None,
    )
