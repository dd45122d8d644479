"""The pencil of epipolar planes of two views, in which a match in depth is one division.

In the frame (axis, first, second), with the axis along the baseline, a viewing ray has a plane
angle phi = atan2(second, first), equal for partners, and a slope, axis over radius, which
differs between partners by baseline / radius of the point: the pencil is to wide baselines
what rows and disparity are to rectified pictures, and stays defined with the epipoles inside
the pictures. A segment's interpretation plane, m . ray = 0, makes its slope a sinusoid of the
angle: slope = p cos phi + q sin phi.

The segments of one view in a pencil, as rows of one table.

A pair of segments cut to the part that both see, and what it predicts in a third view.

Pairs of segments of two views that share epipolar planes, and those of which an end agrees.
"""

from collections.abc import Iterator
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations.table import SegmentTable
from trinoc.match.tuning.candidates import CandidateTuning
from trinoc.numerics.joins import blocks_of_overlapping, overlapping
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import (
    Scalar,
    Vector3,
    add3,
    cross3,
    dot3,
    scaled3,
    times_matrix,
    vector3,
)

# numerical: rows of a table.
_SLOPE_VARIANCES = (11, 12, 13)


class PencilSegments(NamedTuple):
    """The segments of one view in a pencil.

    columns : one row per quantity, in the order of what follows: kernels take and index one array.
    """

    columns: Float[ArrayLike, "16 *n"]

    @property
    def low(self) -> Scalar:
        """Plane angle of one end, in rad, without a jump before `high`."""
        return self.columns[0]

    @property
    def high(self) -> Scalar:
        """Plane angle of the other end, the larger."""
        return self.columns[1]

    @property
    def cosine_low(self) -> Scalar:
        """Cosine of `low`."""
        return self.columns[2]

    @property
    def sine_low(self) -> Scalar:
        """Sine of `low`."""
        return self.columns[3]

    @property
    def cosine_high(self) -> Scalar:
        """Cosine of `high`."""
        return self.columns[4]

    @property
    def sine_high(self) -> Scalar:
        """Sine of `high`."""
        return self.columns[5]

    @property
    def p(self) -> Scalar:
        """Of the slope, p cos + q sin."""
        return self.columns[6]

    @property
    def q(self) -> Scalar:
        """Of the slope, p cos + q sin."""
        return self.columns[7]

    @property
    def normal(self) -> Vector3:
        """Of the interpretation plane, of unit length."""
        return self.columns[8], self.columns[9], self.columns[10]

    @property
    def slope_variance(self) -> Vector3:
        """(c00, c01, c11) of the slopes at the angles low and high, due to the errors of the ends
        across the segment."""
        low, both, high = _SLOPE_VARIANCES
        return self.columns[low], self.columns[both], self.columns[high]

    @property
    def end_variance_px2(self) -> tuple[Scalar, Scalar]:
        """Of the places along the segment, at low and high, that have the plane angles of a
        partner's ends."""
        return self.columns[14], self.columns[15]

    def with_slope_error(self, variance: Scalar) -> "PencilSegments":
        """With an error of the slope at either end beside the others."""
        rows = list(self.columns)
        for row in (_SLOPE_VARIANCES[0], _SLOPE_VARIANCES[-1]):
            rows[row] = rows[row] + variance
        return PencilSegments(array_namespace(rows[0]).stack(rows))


def take_segments(table: PencilSegments, index: Int[ArrayLike, "*p"]) -> PencilSegments:
    """The segments of given numbers."""
    return PencilSegments(table.columns[:, index])


class Pencil(NamedTuple):
    """Frame of the planes through two centres, and the segments of both views in it.

    frame : rows axis, first, second. origin_mm : centre of the first view.
    baseline_mm : distance of the centres. Of each frame of a stack.
    """

    frame: Float[ArrayLike, "*f 3 3"]
    origin_mm: Float[ArrayLike, "*f 3"]
    baseline_mm: Float[ArrayLike, "*f"]
    first: PencilSegments
    second: PencilSegments


def pencil(lines: SegmentTable, a: Int[ArrayLike, ""] | int, b: Int[ArrayLike, ""] | int) -> Pencil:
    """The pencil of views a and b.

    In NumPy outside `jit`: each segment is placed once, which takes less than compiling it would.
    """
    xp = array_namespace(lines, a, b)
    lines = jax.tree.map(xp.asarray, lines)
    across = lines.centre_mm[..., b, :] - lines.centre_mm[..., a, :]
    baseline = xp.sqrt((across**2).sum(-1))
    axis = across / baseline[..., None]
    # Angle zero lies in the middle of what the cameras look at, and the jump behind them.
    forward = lines.matrix_px[..., a, 2, :3] + lines.matrix_px[..., b, 2, :3]
    first = forward - (forward * axis).sum(-1)[..., None] * axis
    first = first / xp.sqrt((first**2).sum(-1))[..., None]
    frame = xp.stack([axis, first, xp.cross(axis, first)], axis=-2)

    views = xp.stack([xp.asarray(a), xp.asarray(b)])
    homography = frame[..., None, :, :] @ lines.inverse[..., views, :, :]
    if lines.frame is None:
        homography = homography[:, None]
    else:
        homography = homography[lines.frame[views], xp.arange(2)[:, None]]
    # A segment in a plane with the baseline has slopes that are infinite, as it has under `jit`.
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = _in_pencil(
            homography, lines.ends_px[views], lines.line[views, :, :2], lines.across_px2[views]
        )
    both = PencilSegments(first), PencilSegments(second)
    return Pencil(frame, lines.centre_mm[..., a, :], baseline, *both)


def take_pencil(
    planes: Pencil, lines: SegmentTable, view: Int[ArrayLike, ""], segment: Int[ArrayLike, "..."]
) -> Pencil:
    """The pencil with the planes of some segments' frames alone."""
    if lines.frame is None:
        return planes
    frame = lines.frame[view, segment]
    return planes._replace(
        frame=planes.frame[frame],
        origin_mm=planes.origin_mm[frame],
        baseline_mm=planes.baseline_mm[frame],
    )


def _in_pencil(
    homography: Float[ArrayLike, "2 *n 3 3"],
    ends_px: Float[ArrayLike, "2 n 2 2"],
    line_normal: Float[ArrayLike, "2 n 2"],
    across_px2: Float[ArrayLike, "2 n 2 2"],
) -> Float[ArrayLike, "2 c n"]:
    """The columns of both views' segments; `homography` takes homogeneous pixels to rays in the
    frame."""
    xp = array_namespace(homography, ends_px)
    rows = [vector3(homography[..., k, :]) for k in range(3)]
    # Both ends in front: (2, view, n).
    u, v = xp.moveaxis(ends_px, -1, 0).transpose(0, 3, 1, 2)
    x, y, z = (c0[None] * u + c1[None] * v + c2[None] for c0, c1, c2 in rows)
    first = xp.arctan2(z[0], y[0])
    turn = xp.arctan2(y[0] * z[1] - z[0] * y[1], y[0] * y[1] + z[0] * z[1])
    normal = cross3((x[0], y[0], z[0]), (x[1], y[1], z[1]))
    p, q = -normal[1] / normal[0], -normal[2] / normal[0]
    # An error across the segment moves the ray by `across`; on its own plane angle that is so much
    # slope. It turns the end's plane as so much way along the segment would.
    nu, nv = line_normal[..., 0], line_normal[..., 1]
    across = [c0 * nu + c1 * nv for c0, c1, _ in rows]
    along = [c0 * nv - c1 * nu for c0, c1, _ in rows[1:]]
    push = (normal[0] * across[0] + normal[1] * across[1] + normal[2] * across[2]) / normal[0]
    slope_per_px = push[None] / xp.sqrt(y * y + z * z)
    turned, by_way = (y * w[1][None] - z * w[0][None] for w in (across[1:], along))
    slide_per_px = turned / by_way
    own = xp.stack([across_px2[..., 0, 0], across_px2[..., 1, 1]])
    ends = xp.stack([first, first + turn]), slope_per_px**2 * own, slide_per_px**2 * own
    swap = turn[None] < 0
    angles, variance, end_variance = (xp.where(swap, end[::-1], end) for end in ends)
    (low, high), cosine, sine = angles, xp.cos(angles), xp.sin(angles)
    unit = scaled3(normal, 1 / xp.sqrt(dot3(normal, normal)))
    together = slope_per_px[0] * slope_per_px[1] * across_px2[..., 0, 1]
    columns = (
        *(low, high, cosine[0], sine[0], cosine[1], sine[1], p, q, *unit),
        *(variance[0], together, variance[1], *end_variance),
    )
    return xp.stack(columns, axis=1)


def plane_angles(
    lines: SegmentTable, view: int, segments: PencilSegments
) -> Float[np.ndarray, "n 2"]:
    """Plane angles of all ends of a view, low and high; those of other frames lie apart."""
    angles = np.stack([np.asarray(segments.low), np.asarray(segments.high)], axis=1)
    if lines.frame is None:
        return angles
    # Half a turn on either side, and not more than another for what one segment spans.
    return angles + 16.0 * np.asarray(lines.frame)[view][:, None]


class CommonPart(NamedTuple):
    """Where the planes of a pencil bound what both segments show.

    at_low, at_high : (slope in the first view, cos, sin, 1 / radius) on both bounding planes.
    possible : whether there is a common part, in front of both cameras.
    """

    low: Scalar
    high: Scalar
    at_low: tuple[Scalar, Scalar, Scalar, Scalar]
    at_high: tuple[Scalar, Scalar, Scalar, Scalar]
    possible: Bool[ArrayLike, "..."]


def cut_pair(
    baseline_mm: Scalar, a: PencilSegments, b: PencilSegments, tuning: CandidateTuning
) -> CommonPart:
    """Cut one segment of either view so that their ends correspond."""
    xp = array_namespace(a.low, b.low)
    low, high = xp.maximum(a.low, b.low), xp.minimum(a.high, b.high)
    shorter = xp.minimum(a.high - a.low, b.high - b.low)
    a_begins, a_ends = a.low > b.low, a.high < b.high

    def on_plane(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        slope = a.p * cosine + a.q * sine
        return slope, cosine, sine, (slope - b.p * cosine - b.q * sine) / baseline_mm

    at_low = on_plane(
        xp.where(a_begins, a.cosine_low, b.cosine_low), xp.where(a_begins, a.sine_low, b.sine_low)
    )
    at_high = on_plane(
        xp.where(a_ends, a.cosine_high, b.cosine_high), xp.where(a_ends, a.sine_high, b.sine_high)
    )
    possible = (high - low > tuning.smallest_overlap * shorter) & (at_low[3] > 0) & (at_high[3] > 0)
    return CommonPart(low, high, at_low, at_high, possible)


def common_ends_mm(planes: Pencil, part: CommonPart) -> tuple[Vector3, Vector3]:
    """Ends in space, world frame, of the common part of a pair."""

    def point(at: tuple[Scalar, Scalar, Scalar, Scalar]) -> Vector3:
        in_frame = scaled3(at[:3], 1 / at[3])
        return add3(vector3(planes.origin_mm), times_matrix(planes.frame.mT, in_frame))

    return point(part.at_low), point(part.at_high)


def pairs_sharing_planes(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    rows: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
    at_once: int,
    ends_px: float | None = None,
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """Pairs of those rows that share epipolar planes, each once, about so many at a time.

    With `ends_px`, only those of which the low ends or the high ends have the same plane, give or
    take so many pixels along either segment.
    """
    first, second = (own.astype(np.int32) for own in rows)
    of_views = [
        plane_angles(lines, int(view), segments)
        for view, segments in zip(views, (planes.first, planes.second), strict=True)
    ]
    if ends_px is None:
        joined = [(of_views[0][first], of_views[1][second])]
    else:
        about = [
            end_angles(lines, int(view), segments, angles, ends_px)
            for view, segments, angles in zip(
                views, (planes.first, planes.second), of_views, strict=True
            )
        ]
        joined = [(about[0][first, end], about[1][second, end]) for end in range(2)]
    for number, (of_first, of_second) in enumerate(joined):
        for block in blocks_of_overlapping(of_first, of_second, at_once):
            i, j = overlapping(of_first[block], of_second)
            i += block.start
            if number:
                # Those of which both ends agree have been met.
                one, other = joined[0][0][i], joined[0][1][j]
                fresh = (one[:, 1] <= other[:, 0]) | (other[:, 1] <= one[:, 0])
                i, j = i[fresh], j[fresh]
            yield first[i], second[j]


def end_angles(
    lines: SegmentTable,
    view: int,
    segments: PencilSegments,
    angles: Float[np.ndarray, "n 2"],
    reach_px: float,
    sigmas: float = 4.0,
) -> Float[np.ndarray, "n 2 2"]:
    """Ranges of plane angle about both ends, low and high, that reach so far along the segment, and
    as many standard deviations further as its direction turns the end's plane."""
    variance = np.stack([np.asarray(x) for x in segments.end_variance_px2], axis=1)
    span = (angles[:, 1] - angles[:, 0])[:, None]
    length = np.asarray(lines.length_px)[view, : len(angles), None]
    reach = (reach_px + sigmas * np.sqrt(variance)) * span / length
    return np.stack([angles - reach, angles + reach], axis=2)
