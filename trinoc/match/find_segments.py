"""Line segments of a picture: Nevatia and Babu's chain from masks to segments."""

import numpy as np
from jaxtyping import Shaped

from trinoc.geometry.segments import Segments
from trinoc.match.nevatia_babu.covariance import MODEL_SIGMA_PX, end_covariances
from trinoc.match.nevatia_babu.ends import crossings_near_ends
from trinoc.match.nevatia_babu.false_alarms import least_evidence
from trinoc.match.nevatia_babu.levels import fine_level, half_level
from trinoc.match.nevatia_babu.line_fit import fit_lines
from trinoc.match.nevatia_babu.masks import combined_kernel
from trinoc.match.nevatia_babu.merging import collinear_successors, merged_runs
from trinoc.match.nevatia_babu.neighbours import overlaps, without_neighbours
from trinoc.match.nevatia_babu.picture import grey_picture
from trinoc.match.nevatia_babu.runs import members
from trinoc.match.nevatia_babu.two_levels import runs_of_both_levels
from trinoc.match.nevatia_babu.validity import blur_of_picture, is_sharp, is_straight

GAP_PX = 8.0
SNAP_PX = 6.0
NEIGHBOUR_ROUNDS = 1
MERGE_ROUNDS = 1
SMOOTHING = 1
LEAST_CONTRAST = 7.0


def find_segments(
    image: Shaped[np.ndarray, "..."], *, tolerance_px: float = 1.6, false_alarms: float = 1.0
) -> Segments:
    """Straight edges of a picture, with polarity, contrast and covariance.

    `image` is (h, w) or (h, w, 3), uint8, uint16 or real numbers. `tolerance_px` is the
    coarsest deviation of an edge from a straight line. The first end of each segment comes
    first when walking with the darker side on the right, so every polarity is +1. Raises
    InputError for what is no picture.
    """
    picture = grey_picture(image)
    height, width = picture.grey.shape
    kernel = combined_kernel(SMOOTHING)
    needed = least_evidence(false_alarms, height * width)
    fine = fine_level(picture.grey, picture.quantum, kernel)
    half = half_level(picture.grey, picture.quantum, kernel)
    points, first = runs_of_both_levels(fine, half, kernel, tolerance_px, LEAST_CONTRAST)
    lines = fit_lines(points, first)
    for _ in range(MERGE_ROUNDS):
        successor = collinear_successors(lines, GAP_PX, tolerance_px / 2)
        order, first = merged_runs(successor, first, len(points.strength))
        points = points.select(order)
        lines = fit_lines(points, first)
    blur = blur_of_picture(lines)
    keep = is_sharp(lines, blur) & (lines.evidence > needed)
    index, _, first = members(first[keep], np.append(first[1:], len(points.strength))[keep])
    points = points.select(index)
    lines = lines.select(keep)
    found = overlaps(points, first, lines)
    for _ in range(NEIGHBOUR_ROUNDS):
        spread = 0.15 * (fine.kernel_variance_px2 + blur.typical)
        own = np.clip(lines.blur_px2, blur.typical - spread, blur.typical + spread)
        lines = fit_lines(without_neighbours(points, lines, own, found), first)
    lines = lines.select(is_straight(lines, width) & (lines.contrast > LEAST_CONTRAST))

    partner, position = crossings_near_ends(
        lines.centre_px, lines.direction, lines.extent_px, SNAP_PX
    )
    lines = lines._replace(extent_px=position)
    count = len(position)
    return Segments(
        lines.endpoints_px,
        end_covariances(
            lines.direction,
            lines.variance_middle_px2 + MODEL_SIGMA_PX**2,
            np.where(partner >= 0, 0.5, 1.5),
        ),
        np.ones(count, dtype=np.int64),
        lines.contrast,
        lines.support.astype(np.int64),
        (width, height),
    )
