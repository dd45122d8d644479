"""Circles that two matched lines suggest, those first for which other lines speak."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from trinoc.match.bodies.circles import Circles, image_circles
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import concatenate_rows, take_rows
from trinoc.numerics.vectors import cross_3d

# numerical: lines that are held against circles at once: for memory, some 100 bytes each.
MOST_AT_ONCE = 1 << 21


def propose_rims(
    lines_mm: Float[np.ndarray, "t 2 3"],
    cameras_px: Float[np.ndarray, "v 3 4"],
    mm_per_px: float,
    tuning: RimTuning,
) -> Circles:
    """Circles that touch two lines each at their middles and that two cameras at least do not see
    edge-on, the best supported ones."""
    middle = lines_mm.mean(axis=1)
    way = lines_mm[:, 1] - lines_mm[:, 0]
    length = np.linalg.norm(way, axis=1)
    unit = way / np.maximum(length, 1e-12)[:, None]
    one, other = _neighbours(middle, tuning.neighbours)
    least, most = (mm_per_px * radius for radius in tuning.radii_px)
    normal = cross_3d(unit[one], unit[other])
    sine = np.linalg.norm(normal, axis=1)
    apart = np.linalg.norm(middle[one] - middle[other], axis=1)
    near = (sine > np.sin(np.radians(tuning.least_turn_deg))) & (apart < 2 * most)
    one, other, normal = one[near], other[near], normal[near] / sine[near, None]
    step = middle[other] - middle[one]
    inward = [cross_3d(normal, unit[own]) for own in (one, other)]
    found = []
    # Both touch from the same side of their directions, or from opposite ones.
    for side in (1.0, -1.0):
        between = inward[0] - side * inward[1]
        reach = (between * step).sum(axis=1) / np.maximum((between**2).sum(axis=1), 1e-12)
        open_mm = np.linalg.norm(step - reach[:, None] * between, axis=1)
        radius = np.abs(reach)
        # Each line is a chord, shorter than the circle is wide.
        wide = radius > np.maximum(length[one], length[other]) / 2
        closes = np.maximum(tuning.closes_px * mm_per_px, tuning.closes_share * radius)
        good = (open_mm < closes) & wide & (radius > least) & (radius < most)
        centre = (middle[one] + middle[other]) / 2
        centre = centre + reach[:, None] * (inward[0] + side * inward[1]) / 2
        found.append((one[good], Circles(centre[good], normal[good], radius[good])))
    line, circles = concatenate_rows(found)
    ratios = np.stack([image_circles(circles, camera).axis_ratio for camera in cameras_px])
    opened = np.flatnonzero((ratios > tuning.least_axis_ratio).sum(axis=0) >= 2)
    line, circles = line[opened], take_rows(circles, opened)
    support = np.zeros(len(line))
    for part in blocks(len(line), max(MOST_AT_ONCE // max(len(lines_mm), 1), 1)):
        some = Circles(*(column[part] for column in circles))
        support[part] = _support(some, middle, unit, length, mm_per_px, tuning)
    # The best of each line, so that one rim of many chords does not hide another.
    best = np.lexsort((-support, line))
    rank = np.arange(len(best)) - np.searchsorted(line[best], line[best])
    best = best[rank < tuning.most_of_line]
    best = best[np.argsort(-support[best], kind="stable")[: tuning.most_circles]]
    return take_rows(circles, best)


def _neighbours(
    middle_mm: Float[np.ndarray, "t 3"], most: int
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Pairs of lines, each with the nearest so many others."""
    count = len(middle_mm)
    if count <= most + 1:
        return np.triu_indices(count, 1)
    near = np.asarray(KDTree(middle_mm).query(middle_mm, most + 1)[1])
    pairs = np.stack([np.repeat(np.arange(count), most + 1), near.ravel()], axis=1)
    pairs = np.unique(np.sort(pairs, axis=1), axis=0)
    first, second = pairs[pairs[:, 0] < pairs[:, 1]].T
    return first, second


def _support(
    circles: Circles,
    middle_mm: Float[np.ndarray, "t 3"],
    unit: Float[np.ndarray, "t 3"],
    length_mm: Float[np.ndarray, "t"],
    mm_per_px: float,
    tuning: RimTuning,
) -> Float[np.ndarray, "h"]:
    """Length of the lines that lie on each circle, as far as lines in space are known."""
    centre, normal, radius = circles
    height = normal @ middle_mm.T - (normal * centre).sum(axis=1)[:, None]
    square = (middle_mm**2).sum(axis=1) - 2 * centre @ middle_mm.T
    square = square + (centre**2).sum(axis=1)[:, None]
    distance = np.sqrt(np.maximum(square - height**2, 1e-12))
    out_of_plane = normal @ unit.T
    radial = (middle_mm * unit).sum(axis=1) - centre @ unit.T - height * out_of_plane
    alike = np.sin(np.radians(tuning.alike_deg))
    near = (tuning.near_px * mm_per_px + tuning.near_share * radius)[:, None]
    on = (np.abs(height) < near) & (np.abs(distance - radius[:, None]) < near)
    on &= (np.abs(out_of_plane) < alike) & (np.abs(radial) < alike * distance)
    return on @ length_mm
