"""How much likelier three segments are as images of one line than as clutter.

In the plane normal to a line in space, the three interpretation planes are three lines with unit
normals n_v. Two normals span that plane, so c_1 n_1 + c_2 n_2 + c_3 n_3 = 0, with c_1 the sine of
the angle between n_2 and n_3, and cyclically. Let d_v be the distance of a point from plane v.
Then r = sum_v c_v d_v is the same for all points: it is the one residual of three views, once the
two unknowns are eliminated, and does not depend on the pair that the line came from. With a flat
prior on the line, the evidence of the three places is exactly N(r; 0, S) / prod_v (pixels per mm),
for both ends together.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.match.observations import ClutterModel, SegmentTable
from trinoc.match.tuning import DEFAULT, CandidateTuning
from trinoc.match.two_view import InterpretationPlane, extent_on_line, interpretation_plane
from trinoc.numerics import (
    ArrayLike,
    Scalar,
    Symmetric3,
    Vector3,
    add3,
    cross3,
    dot3,
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
    possible: Bool[ArrayLike, ""]
    chi_square: Scalar
    log_density: Scalar
    extent_px: tuple[tuple[Scalar, Scalar], ...]
    interval: tuple[tuple[Scalar, Scalar], ...]
    union_ends_mm: tuple[Vector3, Vector3]
    union_covariance_mm2: tuple[Symmetric3, Symmetric3]
    px_per_mm: Scalar


def triple_evidence(
    lines: SegmentTable,
    views: Int[ArrayLike, "3"],
    segments: Int[ArrayLike, "3"],
    near_mm: tuple[Vector3, Vector3],
    clutter: ClutterModel,
    tuning: CandidateTuning = DEFAULT.candidates,
) -> TripleEvidence:
    """Evidence of one segment in each of three views, near a line given by two points."""
    origin = near_mm[0]
    along = unit3(add3(near_mm[1], origin, -1.0))
    extents = [extent_on_line(lines, views[k], segments[k], origin, along) for k in range(3)]
    low = [jnp.minimum(first, second) for first, second in extents]
    high = [jnp.maximum(first, second) for first, second in extents]
    begin = jnp.maximum(jnp.maximum(low[0], low[1]), low[2])
    common = jnp.minimum(jnp.minimum(high[0], high[1]), high[2]) - begin
    overlaps = common > 0
    common = jnp.where(overlaps, common, 1.0)
    points = add3(origin, along, begin), add3(origin, along, begin + common)

    planes = [interpretation_plane(lines, views[k], segments[k], points) for k in range(3)]
    normals = [plane.normal for plane in planes]
    c = [dot3(along, cross3(normals[(k + 1) % 3], normals[(k + 2) % 3])) for k in range(3)]
    r = [total(c[k] * planes[k].distance_mm[e] for k in range(3)) for e in range(2)]
    s00, s01, s11 = (
        total(c[k] ** 2 * planes[k].variance_mm2[i] for k in range(3)) for i in range(3)
    )
    determinant = s00 * s11 - s01**2
    chi_square = (s11 * r[0] ** 2 - 2 * s01 * r[0] * r[1] + s00 * r[1] ** 2) / determinant

    px_per_mm = total(plane.length_px for plane in planes) / (3 * common)
    extents_px = tuple(
        ((low[k] - begin) * px_per_mm, (high[k] - begin) * px_per_mm) for k in range(3)
    )
    log_density = (
        -0.5 * jnp.log(determinant)
        - total(jnp.log(p.px_per_mm[0] * p.px_per_mm[1]) for p in planes)
        - jnp.log(common * common * px_per_mm)
        + jnp.log(planes[0].length_px * planes[1].length_px * planes[2].length_px)
        + log_lengths([second - first for first, second in extents_px], clutter.typical_px)
        - total(clutter.log_density[views[k], segments[k]] for k in range(3))
    )
    length = [high[k] - low[k] for k in range(3)]
    shortest = jnp.minimum(jnp.minimum(length[0], length[1]), length[2])
    longest = jnp.maximum(jnp.maximum(length[0], length[1]), length[2])
    second = length[0] + length[1] + length[2] - shortest - longest
    possible = overlaps & (common > tuning.smallest_overlap * shortest) & (chi_square < tuning.gate)
    possible &= (second > tuning.shortest_to_longest * longest) & jnp.isfinite(log_density)
    first = jnp.minimum(jnp.minimum(low[0], low[1]), low[2])
    last = jnp.maximum(jnp.maximum(high[0], high[1]), high[2])
    outer = add3(origin, along, first), add3(origin, along, last)
    outer_planes = [interpretation_plane(lines, views[k], segments[k], outer) for k in range(3)]
    (outer_first, covariance_first), (outer_last, covariance_last) = (
        adjusted(outer[e], e, along, outer_planes) for e in range(2)
    )
    return TripleEvidence(
        (adjusted(points[0], 0, along, planes)[0], adjusted(points[1], 1, along, planes)[0]),
        possible,
        chi_square,
        log_density,
        extents_px,
        tuple(plane.interval for plane in planes),
        (outer_first, outer_last),
        (covariance_first, covariance_last),
        px_per_mm,
    )


def log_lengths(lengths_px: Sequence[Scalar], typical_px: Float[ArrayLike, ""]) -> Scalar:
    """Log density of one length over clutter's, with ends uniform on the longest."""
    longest = lengths_px[0]
    for length in lengths_px[1:]:
        longest = jnp.maximum(longest, length)

    def log_share(length: Scalar) -> Scalar:
        return jnp.log(typical_px) - 2 * jnp.log(length + typical_px)

    strange = total(log_share(length) for length in lengths_px)
    return log_share(longest) - strange - 2 * (len(lengths_px) - 1) * jnp.log(longest)


def adjusted(
    point: Vector3, end: int, along: Vector3, planes: list[InterpretationPlane]
) -> tuple[Vector3, Symmetric3]:
    """(a point moved across the line to the weighted least-squares fit of all planes, its
    covariance across the line); `end` is 0 or 1, the point's number in the planes."""
    first = planes[0].normal
    second = cross3(along, first)
    n = [(dot3(first, plane.normal), dot3(second, plane.normal)) for plane in planes]
    weight = [1 / plane.variance_mm2[2 * end] for plane in planes]
    each = list(zip(weight, n, [plane.distance_mm[end] for plane in planes], strict=True))
    a00, a01 = (
        total(w * m[0] * m[0] for w, m, _ in each),
        total(w * m[0] * m[1] for w, m, _ in each),
    )
    a11 = total(w * m[1] * m[1] for w, m, _ in each)
    b0, b1 = total(w * m[0] * d for w, m, d in each), total(w * m[1] * d for w, m, d in each)
    determinant = a00 * a11 - a01 * a01
    moved = add3(point, first, -(a11 * b0 - a01 * b1) / determinant)
    moved = add3(moved, second, -(a00 * b1 - a01 * b0) / determinant)
    spread = (a11 / determinant, -a01 / determinant, a00 / determinant)
    return moved, outer3(first, second, spread)
