"""How much likelier three segments are as images of one line than as clutter.

In the plane normal to a line in space, the three interpretation planes are three lines with unit
normals n_v. Two normals span that plane, so c_1 n_1 + c_2 n_2 + c_3 n_3 = 0, with c_1 the sine of
the angle between n_2 and n_3, and cyclically. Let d_v be the distance of a point from plane v.
Then r = sum_v c_v d_v is the same for all points: it is the one residual of three views, once the
two unknowns are eliminated, and does not depend on the pair that the line came from. With a flat
prior on the line, the evidence of the three places is exactly N(r; 0, S) / prod_v (pixels per mm),
for both ends together.

How much likelier two segments are as images of one line than as clutter.

Two views determine a line; only the ends are left to check it. In the notation of
`triple_position`, the evidence of place is 1 / (c prod_v (pixels per mm)) at each end, with c the
sine of the angle between the interpretation planes. Where segments are nearly parallel to
epipolar lines, their ends hardly correspond.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.geometry.projection import image_of_point
from trinoc.match.evidence.endpoints import LEAST_DENSITY
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
    """What three segments say about being one line.

    ends_mm : ends of the part common to all, adjusted to all three views.
    possible : whether there is such a part, near enough to all.
    chi_square : of the place and direction, under the segments' own covariances.
    log_density : logarithm of the evidence of place over that of clutter, apart from
        the density of lines in space, the heavy tail and the ends.
    extent_px : (3, 2) where each view's segment begins and ends along the line, in mean pixels.
    interval : (3, 2) the common part on each segment, 0 at its first end and 1 at its second.
    union_ends_mm : ends of the part that any of the three shows. union_covariance_mm2 : of these,
        across the line; xx, xy, xz, yy, yz, zz.
    px_per_mm : mean image length per length along the line.
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


class _Cut(NamedTuple):
    """The segments on a line: where each begins and ends, where they all do, in mm."""

    origin: Vector3
    along: Vector3
    low: Float[ArrayLike, "3 *h"]
    high: Float[ArrayLike, "3 *h"]
    begin: Float[ArrayLike, "*h"]
    common: Float[ArrayLike, "*h"]
    possible: Bool[ArrayLike, "*h"]

    def points(self, *places: Scalar) -> Vector3:
        """Points at some places on the line, one after the other in front."""
        return add3(
            in_front(self.origin), in_front(self.along), array_namespace(places).stack(places)
        )


def triple_evidence(
    sight: SegmentPlanes,
    near_mm: tuple[Vector3, Vector3],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> TripleEvidence:
    """Evidence of one segment in each of three views, near a line given by two points."""
    xp, cut = array_namespace(sight), _cut(sight, near_mm, tuning)
    begin, end = cut.begin, cut.begin + cut.common
    first, last = least(cut.low), largest(cut.high)
    points = cut.points(begin, end, first, last)
    planes = interpretation_planes(sight, points)
    chi_square, determinant = _misfit(sight, planes, cut.along)

    image_px = image_length_px(planes)
    px_per_mm = total(image_px) / (3 * cut.common)
    low, high = ((x - begin[None]) * px_per_mm[None] for x in (cut.low, cut.high))
    log_density = (
        -0.5 * xp.log(determinant)
        - total(xp.log(planes.px_per_mm[:, 0] * planes.px_per_mm[:, 1]))
        - xp.log(cut.common * cut.common * px_per_mm)
        + xp.log(image_px[0] * image_px[1] * image_px[2])
        + log_lengths(high - low, sight.typical_px)
        - total(sight.log_clutter)
    )
    moved, spread = project_onto_planes(sight, planes, points, cut.along)
    return TripleEvidence(
        (nth3(moved, 0), nth3(moved, 1)),
        cut.possible & (chi_square < tuning.gate) & xp.isfinite(log_density),
        chi_square,
        log_density,
        tuple((low[k], high[k]) for k in range(3)),
        tuple((planes.interval[k, 0], planes.interval[k, 1]) for k in range(3)),
        (nth3(moved, 2), nth3(moved, 3)),
        (nth6(spread, 2), nth6(spread, 3)),
        px_per_mm,
    )


def line_of_three(
    sight: SegmentPlanes,
    near_mm: tuple[Vector3, Vector3],
    tuning: CandidateTuning = DEFAULT.candidates,
) -> tuple[tuple[Vector3, Vector3], Bool[ArrayLike, "*h"]]:
    """(ends of the common part, adjusted to all three views, whether they can be one line)."""
    cut = _cut(sight, near_mm, tuning)
    points = cut.points(cut.begin, cut.begin + cut.common)
    planes = interpretation_planes(sight, points)
    moved = project_onto_planes(sight, planes, points, cut.along)[0]
    possible = cut.possible & (_misfit(sight, planes, cut.along)[0] < tuning.gate)
    return (nth3(moved, 0), nth3(moved, 1)), possible


def _cut(sight: SegmentPlanes, near_mm: tuple[Vector3, Vector3], tuning: CandidateTuning) -> _Cut:
    origin = near_mm[0]
    along = unit3(add3(near_mm[1], origin, -1.0))
    low, high = extents_on_line(sight, origin, along)
    begin = largest(low)
    common = least(high) - begin
    overlaps = common > 0
    length = high - low
    shortest, longest = least(length), largest(length)
    second = total(length) - shortest - longest
    possible = overlaps & (common > tuning.smallest_overlap * shortest)
    possible &= second > tuning.shortest_to_longest * longest
    common = array_namespace(common).where(overlaps, common, 1.0)
    return _Cut(origin, along, low, high, begin, common, possible)


def _misfit(
    sight: SegmentPlanes, planes: InterpretationPlanes, along: Vector3
) -> tuple[Scalar, Scalar]:
    """(chi-square of the residuals at the first two points, determinant of their covariance)."""
    normals = [nth3(planes.normal, k) for k in range(3)]
    across = [cross3(normals[(k + 1) % 3], normals[(k + 2) % 3]) for k in range(3)]
    c = array_namespace(along).stack([dot3(along, normal) for normal in across])
    r = [total(c * planes.distance_mm[:, e]) for e in range(2)]
    pairs = ((0, 0), (0, 1), (1, 1))
    s00, s01, s11 = (total(c**2 * variance_mm2(sight, planes, *pair)) for pair in pairs)
    determinant = s00 * s11 - s01**2
    chi_square = (s11 * r[0] ** 2 - 2 * s01 * r[0] * r[1] + s00 * r[1] ** 2) / determinant
    return chi_square, determinant


def log_lengths(lengths_px: Float[ArrayLike, "v *h"], typical_px: Scalar) -> Float[ArrayLike, "*h"]:
    """Log density of one length over clutter's, with ends uniform on the longest."""
    xp, longest = array_namespace(lengths_px), largest(lengths_px)[None]

    def log_share(length: Scalar) -> Scalar:
        return xp.log(typical_px) - 2 * xp.log(length + typical_px)

    others = lengths_px.shape[0] - 1
    one = log_share(longest) - 2 * others * xp.log(longest)
    return one[0] - total(log_share(lengths_px))


def project_onto_planes(
    sight: SegmentPlanes, planes: InterpretationPlanes, points_mm: Vector3, along: Vector3
) -> tuple[Vector3, Symmetric3]:
    """(points moved across the line to the weighted least-squares fit of all planes, their
    covariance across the line); a number for each point in front."""
    xp = array_namespace(planes)
    nx, ny, nz = planes.normal
    first = nx[:1], ny[:1], nz[:1]
    second = cross3(in_front(along), first)
    n0, n1 = dot3(first, planes.normal)[:, None], dot3(second, planes.normal)[:, None]
    points = range(planes.interval.shape[1])
    weight = 1 / xp.stack([variance_mm2(sight, planes, e, e) for e in points], axis=1)
    distance = planes.distance_mm
    a00, a01, a11 = total(weight * n0 * n0), total(weight * n0 * n1), total(weight * n1 * n1)
    b0, b1 = total(weight * n0 * distance), total(weight * n1 * distance)
    determinant = a00 * a11 - a01 * a01
    moved = add3(points_mm, first, -(a11 * b0 - a01 * b1) / determinant)
    moved = add3(moved, second, -(a00 * b1 - a01 * b0) / determinant)
    spread = (a11 / determinant, -a01 / determinant, a00 / determinant)
    return moved, outer3(first, second, spread)


class PairEvidence(NamedTuple):
    """What two segments say about being one line; fields as in TripleEvidence.

    end_log : (2, c) log density of each component, over clutter's: ends agree, by scale; or not.
    expected : in how many of the other views the line should be seen, as far as their
        borders go. crossing_sine : of the angle between their interpretation planes.
    """

    ends_mm: tuple[Vector3, Vector3]
    possible: Bool[ArrayLike, "..."]
    log_density: Scalar
    end_log: Float[ArrayLike, "2 c *h"]
    interval: tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar
    expected: Scalar
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
    """Evidence of one segment in each of two views; `rows` are the same in their pencil."""
    xp = array_namespace(lines, segments)
    common = cut_pair(planes.baseline_mm, *rows, tuning)
    ends_mm = common_ends_mm(planes, common)
    step = add3(ends_mm[1], ends_mm[0], -1.0)
    length_mm = xp.sqrt(dot3(step, step))
    along = unit3(step)
    sight = segment_planes(lines, clutter, views, segments)
    low_mm, high_mm = extents_on_line(sight, ends_mm[0], along)
    places = xp.zeros_like(length_mm), length_mm, least(low_mm), largest(high_mm)
    points = add3(in_front(ends_mm[0]), in_front(along), xp.stack(places))
    sights = interpretation_planes(sight, points)
    sine = xp.abs(dot3(along, cross3(nth3(sights.normal, 0), nth3(sights.normal, 1))))
    image_px = image_length_px(sights)
    px_per_mm = total(image_px) / (2 * length_mm)
    low, high = low_mm * px_per_mm[None], high_mm * px_per_mm[None]
    lengths = high - low
    log_density = (
        -2 * xp.log(sine)
        - total(xp.log(sights.px_per_mm[:, 0] * sights.px_per_mm[:, 1]))
        - xp.log(length_mm * length_mm * px_per_mm)
        + total(xp.log(image_px))
        + log_lengths(lengths, sight.typical_px)
        - total(sight.log_clutter)
    )
    longest, shortest = largest(lengths), least(lengths)
    slack = xp.stack([total(row.end_variance_px2[e] for row in rows) for e in range(2)])
    difference = xp.stack([low[0] - low[1], high[0] - high[1]])
    spread = project_onto_planes(sight, sights, points, along)[1]
    possible = common.possible & (sine > tuning.smallest_crossing) & xp.isfinite(log_density)
    possible &= (shortest > tuning.shortest_to_longest * longest) & (common.high > common.low)
    components = _components(difference, slack, longest[None], ends)
    place = sights.interval
    return PairEvidence(
        ends_mm,
        possible,
        log_density,
        xp.swapaxes(components, 0, 1),
        ((place[0, 0], place[0, 1]), (place[1, 0], place[1, 1])),
        (nth3(points, 2), nth3(points, 3)),
        (nth6(spread, 2), nth6(spread, 3)),
        px_per_mm,
        _views_expected(lines, views, segments, points),
        sine,
    )


def _components(
    difference: Scalar, slack: Scalar, longest: Scalar, tuning: EndTuning
) -> Float[ArrayLike, "c 2 *h"]:
    xp = array_namespace(difference)
    scale = np.array(tuning.agreeing_px, difference.dtype).reshape(-1, *(1,) * difference.ndim)
    variance = 2 * scale**2 + slack[None]
    density = xp.exp(-0.5 * difference[None] ** 2 / variance) / xp.sqrt(2 * np.pi * variance)
    agreeing = xp.log(longest[None] * density + LEAST_DENSITY)
    return xp.concatenate([agreeing, xp.zeros_like(difference)[None]])


def _views_expected(
    lines: SegmentTable,
    views: Int[ArrayLike, "2"],
    segments: Int[ArrayLike, "2 *h"],
    points_mm: Vector3,
) -> Float[ArrayLike, "*h"]:
    """Number of other views within whose borders, and before which, the first two points lie."""
    every = np.arange(lines.matrix_px.shape[-3])
    items = (1,) * (segments.ndim - 1)
    view = every.reshape(-1, *items)
    camera = view if lines.frame is None else (lines.frame[views[0], segments[0]][None], view)
    x, y, z = (coordinate[:2] for coordinate in points_mm)
    (u, v), depth = image_of_point(lines.matrix_px[camera][:, None], in_front((x, y, z)))
    size = lines.size_px[camera][:, None]
    inside = (depth > 0) & (u > 0) & (u < size[..., 0]) & (v > 0) & (v < size[..., 1])
    other = (views[0] != every) & (views[1] != every)
    seen = inside.all(axis=1) & other.reshape(-1, *items)
    return seen.astype(u.dtype).sum(axis=0)
