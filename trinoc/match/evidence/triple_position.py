"""Evidence of position: log likelihood ratio of three (or two) segments as one line against
clutter.

Three views. In the plane normal to a line in space, the three interpretation planes are three lines
with unit normals n_v. Two normals span that plane, so c_1 n_1 + c_2 n_2 + c_3 n_3 = 0, with c_1 the
sine of the angle between n_2 and n_3, and cyclically. Let d_v be the distance of a point from plane
v. Then r = sum_v c_v d_v is the same for all points. It is the only residual of three views after
the two unknowns are eliminated, and does not depend on the pair that gave the line. With a flat
prior on the line, the evidence of the three positions is exactly N(r; 0, S) / prod_v (pixels per
mm), for both ends together.

Two views. They determine a line, and only the ends remain to test it. The evidence of position
is 1 / (c prod_v (pixels per mm)) at each end, with c the sine of the angle between the
interpretation planes. The ends of segments nearly parallel to epipolar lines hardly correspond.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import image_of_point
from trinoc.match.evidence.endpoints import SMALLEST_DENSITY
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.match.tuning.every_group import DEFAULT
from trinoc.match.tuning.evidence import EndTuning
from trinoc.match.two_view.epipolar_pencil import (
    Pencil,
    PencilSegments,
    common_ends_mm,
    cut_pair,
)
from trinoc.match.two_view.planes import (
    InterpretationPlanes,
    SegmentPlanes,
    extents_on_line,
    image_length_px,
    interpretation_planes,
    segment_planes,
    variance_mm2,
)
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import (
    Scalar,
    Symmetric3,
    Vector3,
    add3,
    cross3,
    dot3,
    in_front,
    largest,
    least,
    nth3,
    nth6,
    outer3,
    total,
    unit3,
)


class TripleEvidence(NamedTuple):
    """Evidence that three segments are images of one line in space.

    Attributes
    ----------
    ends_mm : two of (3,)
        Ends of the common part on the fitted line, world frame.
    possible : ()
        True if the segments have a common part and pass the chi-square gate.
    chi_square : ()
        Chi-square of the two residuals of position and direction.
    log_density : ()
        Log density of the positions over that of clutter. The density of lines in space, the heavy
        tail and the ends are not included.
    extent_px : (3, 2)
        Interval of each segment along the line, measured from the first end of the common part. The
        unit is the mean pixel of the three views.
    interval : (3, 2)
        Common part on each segment: positions from 0 at its first end to 1 at its second.
    union_ends_mm : two of (3,)
        Ends of the part of the line that any of the three segments shows.
    union_covariance_mm2 : two of (6,)
        Covariance of each of these ends across the line: xx, xy, xz, yy, yz, zz.
    px_per_mm : ()
        Length in the image over length on the line, mean of the three views.
    """

    ends_mm: tuple[Vector3, Vector3]
    possible: Bool[ArrayLike, "..."]
    chi_square: Scalar
    log_density: Scalar
    extent_px: tuple[tuple[Scalar, Scalar], ...]
    interval: tuple[tuple[Scalar, Scalar], ...]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar


class _LineIntervals(NamedTuple):
    """Intervals of three segments on a line in space, as positions in mm from `origin`.

    Attributes
    ----------
    origin, direction : (3,)
        Point and unit direction of the line, world frame.
    low, high : (3, h)
        Interval of each segment.
    begin, common : (h,)
        Begin and length of the common interval.
    possible : (h,)
        True if the intervals overlap enough and have similar lengths.
    """

    origin: Vector3
    direction: Vector3
    low: Float[ArrayLike, "3 *h"]
    high: Float[ArrayLike, "3 *h"]
    begin: Float[ArrayLike, "*h"]
    common: Float[ArrayLike, "*h"]
    possible: Bool[ArrayLike, "*h"]

    def points(self, *positions: Scalar) -> Vector3:
        """Return the points of the line at given positions, with a leading axis of positions."""
        return add3(
            in_front(self.origin),
            in_front(self.direction),
            array_namespace(positions).stack(positions),
        )


def triple_evidence(
    segments: SegmentPlanes,
    line_mm: tuple[Vector3, Vector3],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> TripleEvidence:
    """Compute the evidence of one segment in each of three views, on a given line in space.

    `line_mm` are two points of the line, which must lie near the best fit.
    """
    xp, intervals = array_namespace(segments), _intervals_on_line(segments, line_mm, tuning)
    begin, end = intervals.begin, intervals.begin + intervals.common
    union_begin, union_end = least(intervals.low), largest(intervals.high)
    points = intervals.points(begin, end, union_begin, union_end)
    planes = interpretation_planes(segments, points)
    chi_square, determinant = _misfit(segments, planes, intervals.direction)

    image_lengths = image_length_px(planes)
    px_per_mm = total(image_lengths) / (3 * intervals.common)
    low, high = ((x - begin[None]) * px_per_mm[None] for x in (intervals.low, intervals.high))
    log_density = (
        -0.5 * xp.log(determinant)
        - total(xp.log(planes.px_per_mm[:, 0] * planes.px_per_mm[:, 1]))
        - xp.log(intervals.common * intervals.common * px_per_mm)
        + xp.log(image_lengths[0] * image_lengths[1] * image_lengths[2])
        + log_lengths(high - low, segments.typical_px)
        - total(segments.log_clutter)
    )
    adjusted_mm, covariance = project_onto_planes(segments, planes, points, intervals.direction)
    return TripleEvidence(
        (nth3(adjusted_mm, 0), nth3(adjusted_mm, 1)),
        intervals.possible & (chi_square < tuning.gate) & xp.isfinite(log_density),
        chi_square,
        log_density,
        tuple((low[k], high[k]) for k in range(3)),
        tuple((planes.interval[k, 0], planes.interval[k, 1]) for k in range(3)),
        (nth3(adjusted_mm, 2), nth3(adjusted_mm, 3)),
        (nth6(covariance, 2), nth6(covariance, 3)),
        px_per_mm,
    )


def line_of_three(
    segments: SegmentPlanes,
    line_mm: tuple[Vector3, Vector3],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> tuple[tuple[Vector3, Vector3], Bool[ArrayLike, "*h"]]:
    """Fit a line in space to one segment in each of three views, from an approximate line.

    Returns (the two ends of the common part, mm, mask of the triples that can be one line).
    `line_mm` are two points of the approximate line.
    """
    intervals = _intervals_on_line(segments, line_mm, tuning)
    points = intervals.points(intervals.begin, intervals.begin + intervals.common)
    planes = interpretation_planes(segments, points)
    adjusted_mm = project_onto_planes(segments, planes, points, intervals.direction)[0]
    possible = intervals.possible & (
        _misfit(segments, planes, intervals.direction)[0] < tuning.gate
    )
    return (nth3(adjusted_mm, 0), nth3(adjusted_mm, 1)), possible


def _intervals_on_line(
    segments: SegmentPlanes, line_mm: tuple[Vector3, Vector3], tuning: CandidateTuning
) -> _LineIntervals:
    origin = line_mm[0]
    direction = unit3(add3(line_mm[1], origin, -1.0))
    low, high = extents_on_line(segments, origin, direction)
    begin = largest(low)
    common = least(high) - begin
    overlaps = common > 0
    length = high - low
    shortest, longest = least(length), largest(length)
    second = total(length) - shortest - longest
    possible = overlaps & (common > tuning.smallest_overlap * shortest)
    possible &= second > tuning.shortest_to_longest * longest
    common = array_namespace(common).where(overlaps, common, 1.0)
    return _LineIntervals(origin, direction, low, high, begin, common, possible)


def _misfit(
    segments: SegmentPlanes, planes: InterpretationPlanes, direction: Vector3
) -> tuple[Scalar, Scalar]:
    """Return the chi-square of the residuals at two points, and the determinant of their
    covariance.

    The points are the first two of `planes`. The module docstring defines r, the one residual of
    three views at a point.
    """
    normals = [nth3(planes.normal, k) for k in range(3)]
    crossings = [cross3(normals[(k + 1) % 3], normals[(k + 2) % 3]) for k in range(3)]
    c = array_namespace(direction).stack([dot3(direction, normal) for normal in crossings])
    r = [total(c * planes.distance_mm[:, e]) for e in range(2)]
    pairs = ((0, 0), (0, 1), (1, 1))
    s00, s01, s11 = (total(c**2 * variance_mm2(segments, planes, *pair)) for pair in pairs)
    determinant = s00 * s11 - s01**2
    chi_square = (s11 * r[0] ** 2 - 2 * s01 * r[0] * r[1] + s00 * r[1] ** 2) / determinant
    return chi_square, determinant


def log_lengths(lengths_px: Float[ArrayLike, "v *h"], typical_px: Scalar) -> Float[ArrayLike, "*h"]:
    """Log likelihood ratio of the segments' lengths, one line against clutter, (h,).

    One line is assumed to be as long as the longest segment, with the ends of the other segments
    uniform on it. `typical_px` is the typical length of clutter.
    """
    xp, longest = array_namespace(lengths_px), largest(lengths_px)[None]

    def log_share(length: Scalar) -> Scalar:
        return xp.log(typical_px) - 2 * xp.log(length + typical_px)

    other_views = lengths_px.shape[0] - 1
    single = log_share(longest) - 2 * other_views * xp.log(longest)
    return single[0] - total(log_share(lengths_px))


def project_onto_planes(
    segments: SegmentPlanes, planes: InterpretationPlanes, points_mm: Vector3, direction: Vector3
) -> tuple[Vector3, Symmetric3]:
    """Move points of a line to the positions that fit all interpretation planes best.

    Each point moves perpendicular to `direction`, by weighted least squares. A plane has the weight
    1 / variance of its segment at the point. Returns (points, covariance across the line), with a
    leading axis of points.
    """
    xp = array_namespace(planes)
    nx, ny, nz = planes.normal
    first = nx[:1], ny[:1], nz[:1]
    second = cross3(in_front(direction), first)
    n0, n1 = dot3(first, planes.normal)[:, None], dot3(second, planes.normal)[:, None]
    points = range(planes.interval.shape[1])
    weight = 1 / xp.stack([variance_mm2(segments, planes, e, e) for e in points], axis=1)
    distance = planes.distance_mm
    a00, a01, a11 = total(weight * n0 * n0), total(weight * n0 * n1), total(weight * n1 * n1)
    b0, b1 = total(weight * n0 * distance), total(weight * n1 * distance)
    determinant = a00 * a11 - a01 * a01
    adjusted_mm = add3(points_mm, first, -(a11 * b0 - a01 * b1) / determinant)
    adjusted_mm = add3(adjusted_mm, second, -(a00 * b1 - a01 * b0) / determinant)
    inverse_entries = (a11 / determinant, -a01 / determinant, a00 / determinant)
    return adjusted_mm, outer3(first, second, inverse_entries)


class PairEvidence(NamedTuple):
    """Evidence that two segments are images of one line in space.

    Other attributes are as in `TripleEvidence`.

    Attributes
    ----------
    end_log : (2, c)
        For both ends, log density of each component over that of clutter. The last component means
        that the two segment ends do not correspond. The others mean that they correspond, with each
        scale of their distance.
    expected_views : ()
        Number of other views whose image contains the line.
    crossing_sine : ()
        Sine of the angle between the two interpretation planes.
    """

    ends_mm: tuple[Vector3, Vector3]
    possible: Bool[ArrayLike, "..."]
    log_density: Scalar
    end_log: Float[ArrayLike, "2 c *h"]
    interval: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar
    expected_views: Scalar
    crossing_sine: Scalar


def pair_evidence(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    planes: Pencil,
    rows: tuple[PencilSegments, PencilSegments],
    segments: Int[ArrayLike, "2 *h"],
    clutter: ClutterModel,
    tuning: CandidateTuning = DEFAULT.candidates,
    ends: EndTuning = DEFAULT.ends,
) -> PairEvidence:
    """Compute the evidence of one segment in each of two views.

    `segments` (2, h) are the indices of the segments. `rows` are the same segments in the pencil of
    the two views.
    """
    xp = array_namespace(lines, segments)
    common = cut_pair(planes.baseline_mm, *rows, tuning)
    ends_mm = common_ends_mm(planes, common)
    step = add3(ends_mm[1], ends_mm[0], -1.0)
    length_mm = xp.sqrt(dot3(step, step))
    direction = unit3(step)
    segment_planes_of_pair = segment_planes(lines, clutter, views, segments)
    low_mm, high_mm = extents_on_line(segment_planes_of_pair, ends_mm[0], direction)
    positions = xp.zeros_like(length_mm), length_mm, least(low_mm), largest(high_mm)
    points = add3(in_front(ends_mm[0]), in_front(direction), xp.stack(positions))
    planes_at_points = interpretation_planes(segment_planes_of_pair, points)
    sine = xp.abs(
        dot3(direction, cross3(nth3(planes_at_points.normal, 0), nth3(planes_at_points.normal, 1)))
    )
    image_px = image_length_px(planes_at_points)
    px_per_mm = total(image_px) / (2 * length_mm)
    low, high = low_mm * px_per_mm[None], high_mm * px_per_mm[None]
    lengths = high - low
    log_density = (
        -2 * xp.log(sine)
        - total(xp.log(planes_at_points.px_per_mm[:, 0] * planes_at_points.px_per_mm[:, 1]))
        - xp.log(length_mm * length_mm * px_per_mm)
        + total(xp.log(image_px))
        + log_lengths(lengths, segment_planes_of_pair.typical_px)
        - total(segment_planes_of_pair.log_clutter)
    )
    longer, shorter = largest(lengths), least(lengths)
    cut_variance = xp.stack([total(row.end_variance_px2[e] for row in rows) for e in range(2)])
    difference = xp.stack([low[0] - low[1], high[0] - high[1]])
    covariance = project_onto_planes(segment_planes_of_pair, planes_at_points, points, direction)[1]
    possible = common.possible & (sine > tuning.smallest_crossing) & xp.isfinite(log_density)
    possible &= (shorter > tuning.shortest_to_longest * longer) & (common.high > common.low)
    components = _pair_end_components(difference, cut_variance, longer[None], ends)
    interval = planes_at_points.interval
    return PairEvidence(
        ends_mm,
        possible,
        log_density,
        xp.swapaxes(components, 0, 1),
        ((interval[0, 0], interval[0, 1]), (interval[1, 0], interval[1, 1])),
        (nth3(points, 2), nth3(points, 3)),
        (nth6(covariance, 2), nth6(covariance, 3)),
        px_per_mm,
        _count_expected_views(lines, views, segments, points),
        sine,
    )


def _pair_end_components(
    difference: Scalar, cut_variance: Scalar, longest: Scalar, tuning: EndTuning
) -> Float[ArrayLike, "c 2 *h"]:
    xp = array_namespace(difference)
    scale = np.array(tuning.agreement_px, difference.dtype).reshape(-1, *(1,) * difference.ndim)
    variance = 2 * scale**2 + cut_variance[None]
    density = xp.exp(-0.5 * difference[None] ** 2 / variance) / xp.sqrt(2 * np.pi * variance)
    agreeing = xp.log(longest[None] * density + SMALLEST_DENSITY)
    return xp.concatenate([agreeing, xp.zeros_like(difference)[None]])


def _count_expected_views(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    segments: Int[ArrayLike, "2 *h"],
    points_mm: Vector3,
) -> Float[ArrayLike, "*h"]:
    """Return the number of other views whose image contains the line of each pair, (h,).

    The first two of `points_mm` are the ends of the line. Both must lie in the image and in front
    of the camera. `views` are the two views of the pair.
    """
    all_views = np.arange(lines.matrix_px.shape[-3])
    items = (1,) * (segments.ndim - 1)
    view = all_views.reshape(-1, *items)
    camera = view if lines.frame is None else (lines.frame[views[0], segments[0]][None], view)
    x, y, z = (coordinate[:2] for coordinate in points_mm)
    (u, v), depth = image_of_point(lines.matrix_px[camera][:, None], in_front((x, y, z)))
    size = lines.size_px[camera][:, None]
    is_inside = (depth > 0) & (u > 0) & (u < size[..., 0]) & (v > 0) & (v < size[..., 1])
    is_other_view = (views[0] != all_views) & (views[1] != all_views)
    is_expected = is_inside.all(axis=1) & is_other_view.reshape(-1, *items)
    return is_expected.astype(u.dtype).sum(axis=0)
