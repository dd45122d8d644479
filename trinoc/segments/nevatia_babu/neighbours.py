"""Correction for neighbouring edges: their pull is subtracted from the positions of edge points.

Two edges closer than a few profile widths overlap in the gradient, and each shifts the other's
peak. Once all lines are known, the contribution of each neighbour to a point's profile is computed.
It is subtracted from the three samples, and the point is located again.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.joins import distinct, expand_ranges, point_tree
from trinoc.segments.nevatia_babu.edge_points import FARTHEST, LEAST_SIDE, EdgePoints, Runs
from trinoc.segments.nevatia_babu.endpoints import SAMPLE_PX, line_samples
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT, ErrorTuning

# Fourth cumulant of the kernel's profile, whose tails fall faster than those of a Gaussian.
_TAIL = 2.6 / 24  # numerical: a property of the masks


_ERF_SLOPE = np.float32(1.2)  # numerical: erf(x) is tanh(1.2 x) to .02


_LEAST_PULL = 0.002  # numerical: less than single precision and noise leave


def find_near_lines(
    lines: FittedLines, radius_px: float
) -> tuple[Int[np.ndarray, "p"], Int[np.ndarray, "p"]]:
    """Return all ordered pairs of different lines closer than about `radius_px`, as two arrays
    (p,).
    """
    owner, samples = line_samples(lines.pieces, SAMPLE_PX)
    # The nearest points of two lines have samples within half a spacing. Their connection is
    # perpendicular to a line that does not end there, so the samples are at most this far apart.
    radius = float(np.hypot(radius_px, SAMPLE_PX))
    near_samples = point_tree(samples).query_pairs(radius, output_type="ndarray")
    one, other = owner[near_samples[:, 0]], owner[near_samples[:, 1]]
    different = one != other
    one, other = one[different], other[different]
    count = len(owner)
    key = distinct(np.minimum(one, other) * count + np.maximum(one, other))
    one, other = np.divmod(key, max(count, 1))
    return np.divmod(np.sort(np.concatenate([key, other * count + one])), max(count, 1))


class Overlaps(NamedTuple):
    """Pairs of an edge point and a line nearby that the point does not belong to.

    Attributes
    ----------
    point, line : (m,)
        Index of the point, and index of the line.
    along, across : (m,)
        Position of the point's pixel relative to the centre of the line, px. `across` is positive
        on the brighter side, the left of the line's direction.
    """

    point: Int[np.ndarray, "m"]
    line: Int[np.ndarray, "m"]
    along: Float[np.ndarray, "m"]
    across: Float[np.ndarray, "m"]


def find_overlaps(
    runs: Runs,
    lines: FittedLines,
    profile_variance_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> Overlaps:
    """List all pairs of an edge point and a line of another run nearby.

    The distance is a number of standard deviations of a typical edge profile, whose variance is
    `profile_variance_px2`.
    """
    points = runs.points
    radius_px = tuning.reach_widths * float(np.sqrt(profile_variance_px2))
    one, other = find_near_lines(lines, radius_px)
    pair, point = expand_ranges(runs.first[one], (runs.first + runs.count)[one])
    # Most points of a line are far from the other one, so the cheap test comes first.
    centre_u, centre_v = lines.centre_px.astype(np.float32)[other].T
    direction_u, direction_v = lines.direction.astype(np.float32)[other].T
    offset_u = np.take(points.sample_px[:, 0], point) - np.take(centre_u, pair)
    offset_v = np.take(points.sample_px[:, 1], point) - np.take(centre_v, pair)
    across = offset_u * np.take(direction_v, pair) - offset_v * np.take(direction_u, pair)
    near_rows = np.flatnonzero(np.abs(across) < radius_px)
    pair = pair[near_rows]
    along = offset_u[near_rows] * direction_u[pair] + offset_v[near_rows] * direction_v[pair]
    before, after = lines.extent_px.astype(np.float32)[other].T
    is_alongside = (along > before[pair] - radius_px) & (along < after[pair] + radius_px)
    near_rows, pair = near_rows[is_alongside], pair[is_alongside]
    return Overlaps(point[near_rows], other[pair], along[is_alongside], across[near_rows])


def without_neighbours(
    points: EdgePoints,
    lines: FittedLines,
    blur_px2: float,
    overlaps: Overlaps,
) -> EdgePoints:
    """Correct edge points for the gradient of neighbouring lines, and locate the points again.

    The gradient of each neighbour is subtracted from the profile of the point. `blur_px2` is the
    typical blur variance of edges. A point gets almost no weight if its profile is mostly that of a
    neighbour.
    """
    point, line, along, across = overlaps
    if len(point) == 0:
        return points
    direction_u, direction_v = (column[line] for column in lines.direction.astype(np.float32).T)
    normal_u, normal_v = (np.take(column, point) for column in points.normal.T)
    before, after = (column[line] for column in lines.extent_px.astype(np.float32).T)
    # The line's normal is (way_v, -way_u), toward its brighter side.
    cosine = direction_v * normal_u - direction_u * normal_v
    axis, spacing = points.along_u[point], points.spacing_px[point]
    step_along = np.where(axis, direction_u, direction_v) * spacing
    step_across = np.where(axis, direction_v, -direction_u) * spacing
    variance = points.kernel_variance_px2[point] + np.float32(blur_px2)
    height = (lines.contrast / np.sqrt(2 * np.pi)).astype(np.float32)[line]
    height *= cosine / np.sqrt(variance)
    height *= lines.light_per_level.astype(np.float32)[line] / points.light_per_level[point]
    halved, tail = -0.5 / variance, -np.float32(_TAIL) / variance**4
    scale = _ERF_SLOPE * np.sqrt(-halved)
    neighbour_profile = np.zeros((3, len(points.strength)), dtype=np.float32)
    for sample, step in enumerate((-1, 0, 1)):
        t, squared = along + step * step_along, np.square(across + step * step_across)
        window = np.tanh((t - before) * scale) - np.tanh((t - after) * scale)
        shape = np.exp(squared * (halved + tail * squared))
        neighbour_profile[sample] = np.bincount(
            point, 0.5 * height * shape * window, minlength=len(points.strength)
        )
    return _relocate_points(points, neighbour_profile)


def _relocate_points(points: EdgePoints, neighbour_profile: Float[np.ndarray, "3 n"]) -> EdgePoints:
    largest = np.abs(neighbour_profile).max(axis=0)
    affected = np.flatnonzero(largest > _LEAST_PULL * points.profile[:, 1])
    before = points.take(affected)
    profile = before.profile - neighbour_profile[:, affected].T
    middle = profile[:, 1]
    located, variance = before.locate(np.maximum(profile, 1e-3 * middle[:, None]))
    share = middle / before.profile[:, 1]
    # Points move along one image axis.
    displacement = located - before.sample_px
    usable = (
        (np.minimum(profile[:, 0], profile[:, 2]) > LEAST_SIDE * middle)
        & (middle > 0)
        & (np.abs(displacement[:, 0] + displacement[:, 1]) < FARTHEST * before.spacing_px)
    )
    share = np.where(usable, share, 1e-3)
    uv_px, sharpness = points.uv_px.copy(), points.sharpness.copy()
    strength, information = points.strength.copy(), points.information.copy()
    uv_px[affected[usable]] = located[usable]
    sharpness[affected[usable]] = ((before.kernel_variance_px2 + 1) / variance)[usable]
    strength[affected] = before.profile[:, 1] * share
    # Relative to the measured profile, because the points may have been corrected before.
    information[affected] = before.information * np.square(
        before.profile[:, 1] * share / before.strength
    )
    return points._replace(
        uv_px=uv_px, sharpness=sharpness, strength=strength, information=information
    )
