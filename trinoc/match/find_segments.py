"""Line segments of a picture: Nevatia and Babu's chain from masks to segments."""

import numpy as np
from jaxtyping import Shaped

from trinoc.geometry.segments import Segments
from trinoc.match.nevatia_babu.chains import ordered_chains
from trinoc.match.nevatia_babu.covariance import end_covariances, variance_across
from trinoc.match.nevatia_babu.ends import crossings_near_ends
from trinoc.match.nevatia_babu.gradient import gradient_of
from trinoc.match.nevatia_babu.line_fit import fit_lines
from trinoc.match.nevatia_babu.linking import successors
from trinoc.match.nevatia_babu.masks import combined_kernel
from trinoc.match.nevatia_babu.merging import collinear_successors, merged_runs
from trinoc.match.nevatia_babu.noise import noise_sigma
from trinoc.match.nevatia_babu.picture import grey_picture
from trinoc.match.nevatia_babu.polygon import split_chains
from trinoc.match.nevatia_babu.runs import members
from trinoc.match.nevatia_babu.thinning import edge_points
from trinoc.match.nevatia_babu.validity import is_sharp, is_straight, typical_variance

LEAST_POINTS = 6
GAP_PX = 8.0
SNAP_PX = 6.0
TRIM = 1


def find_segments(image: Shaped[np.ndarray, "..."], *, tolerance_px: float = 1.6) -> Segments:
    """Straight edges of a picture, with polarity, contrast and covariance.

    `image` is (h, w) or (h, w, 3), uint8, uint16 or real numbers. `tolerance_px` is the
    coarsest deviation of an edge from a straight line. The first end of each segment comes
    first when walking with the darker side on the right, so every polarity is +1. Raises
    InputError for what is no picture.
    """
    picture = grey_picture(image)
    kernel = combined_kernel(smoothing=1)
    noise = noise_sigma(picture.grey, picture.quantum)
    gradient = gradient_of(picture.grey, kernel)
    points = edge_points(gradient, 3.0 * noise * kernel.noise_gain)
    order, starts = ordered_chains(successors(points, picture.grey.shape))
    points = points.select(order)
    start, stop = split_chains(points.uv_px, starts, tolerance_px, LEAST_POINTS)
    index, _, first = members(start + TRIM, stop - TRIM)
    points = points.select(index)
    lines = fit_lines(points, first)
    for _ in range(2):
        successor = collinear_successors(lines, GAP_PX, tolerance_px / 2)
        order, first = merged_runs(successor, first, len(points.pixel))
        points = points.select(order)
        lines = fit_lines(points, first)
    length = np.ptp(lines.extent_px, axis=1)
    sigma = np.sqrt(variance_across(lines, length, noise, kernel))
    keep = is_sharp(lines, typical_variance(lines, kernel.variance_px2))
    keep &= is_straight(lines, sigma, picture.grey.shape[1])
    lines = lines.select(keep)

    partner, position = crossings_near_ends(
        lines.centre_px, lines.direction, lines.extent_px, SNAP_PX
    )
    lines = lines._replace(extent_px=position)
    length = np.ptp(position, axis=1)
    variance = variance_across(lines, length, noise, kernel)
    count = len(length)
    height, width = picture.grey.shape
    return Segments(
        lines.endpoints_px,
        end_covariances(lines.direction, variance, np.where(partner >= 0, 0.5, 1.5)),
        np.ones(count, dtype=np.int64),
        lines.strength * np.sqrt(2 * np.pi * lines.variance_px2),
        lines.support.astype(np.int64),
        (width, height),
    )
