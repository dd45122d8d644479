"""Pencil of epipolar planes of two views: it reduces the depth of a match to one division.

The frame of the pencil is (axis, first, second), with the axis along the baseline. A viewing ray
has a plane angle phi = atan2(second, first), which is equal for partners. It has a slope, axis over
radius, which differs between partners by baseline / radius of the point. For wide baselines the
pencil thus replaces the rows and disparities of rectified images. It also works with the epipoles
inside the images. A segment's interpretation plane, m . ray = 0, makes its slope a sinusoid of the
angle: slope = p cos phi + q sin phi.

The file has three parts: segments of a view in a pencil, the common part of a pair, and the
search for pairs that share epipolar planes.
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
    """Segments of one view in the frame of an epipolar pencil, one column for each segment.

    Plane angles are the angles of the epipolar planes through the ends. The slope of a viewing ray
    is its coordinate along the baseline over its distance from the baseline. The array `columns`
    contains all properties, because compiled programs index this array as a whole.
    """

    columns: Float[ArrayLike, "16 *n"]

    @property
    def low(self) -> Scalar:
        """Smaller plane angle of the two ends, rad."""
        return self.columns[0]

    @property
    def high(self) -> Scalar:
        """Larger plane angle of the two ends, rad. It exceeds `low` by less than pi, without a jump
        of 2 pi.
        """
        return self.columns[1]

    @property
    def cosine_low(self) -> Scalar:
        """Cosine of `low`, the smaller plane angle of the segment's two ends."""
        return self.columns[2]

    @property
    def sine_low(self) -> Scalar:
        """Sine of `low`, the smaller plane angle of the segment's two ends."""
        return self.columns[3]

    @property
    def cosine_high(self) -> Scalar:
        """Cosine of `high`, the larger plane angle of the segment's two ends."""
        return self.columns[4]

    @property
    def sine_high(self) -> Scalar:
        """Sine of `high`: the larger of the angles of the two epipolar planes through the ends."""
        return self.columns[5]

    @property
    def p(self) -> Scalar:
        """Coefficient p of the segment's slope p cos(phi) + q sin(phi).

        This is the slope of the viewing ray of the segment's point at the plane angle phi.
        """
        return self.columns[6]

    @property
    def q(self) -> Scalar:
        """Coefficient q of the segment's slope p cos(phi) + q sin(phi).

        This is the slope of the viewing ray of the segment's point at the plane angle phi.
        """
        return self.columns[7]

    @property
    def normal(self) -> Vector3:
        """Unit normal of the interpretation plane, in the frame of the pencil."""
        return self.columns[8], self.columns[9], self.columns[10]

    @property
    def slope_variance(self) -> Vector3:
        """Variances and covariance (c00, c01, c11) of the slopes of the rays at `low` and `high`.

        The values follow from the errors of the ends across the segment.
        """
        low, joint, high = _SLOPE_VARIANCES
        return self.columns[low], self.columns[joint], self.columns[high]

    @property
    def end_variance_px2(self) -> tuple[Scalar, Scalar]:
        """Variances of the positions along the segment at which it has the angles `low` and `high`,
        px^2.

        An error across the segment moves its intersections with these two epipolar planes.
        """
        return self.columns[14], self.columns[15]

    def with_slope_error(self, variance: Scalar) -> "PencilSegments":
        """Return the segments with `variance` added to the variance of the slope at both ends."""
        rows = list(self.columns)
        for row in (_SLOPE_VARIANCES[0], _SLOPE_VARIANCES[-1]):
            rows[row] = rows[row] + variance
        return PencilSegments(array_namespace(rows[0]).stack(rows))


def take_segments(table: PencilSegments, index: Int[ArrayLike, "*p"]) -> PencilSegments:
    """Return the segments with the given indices."""
    return PencilSegments(table.columns[:, index])


class Pencil(NamedTuple):
    """Epipolar pencil: all planes through the centres of two cameras, and the segments of both
    views.

    In a stack of frames, the first three attributes have a leading axis of frames.

    Attributes
    ----------
    frame : (3, 3)
        Unit vectors of the pencil's frame as rows, in the world frame. The first is along the
        baseline, the second is the direction of plane angle 0.
    origin_mm : (3,)
        Centre of the first camera, world frame.
    baseline_mm : ()
        Distance of the two centres.
    first, second : PencilSegments
        Segments of the first and of the second view.
    """

    frame: Float[ArrayLike, "*f 3 3"]
    origin_mm: Float[ArrayLike, "*f 3"]
    baseline_mm: Float[ArrayLike, "*f"]
    first: PencilSegments
    second: PencilSegments


def build_pencil(
    lines: SegmentTable, a: Int[ArrayLike, ""] | int, b: Int[ArrayLike, ""] | int
) -> Pencil:
    """Build the epipolar pencil of the views a and b.

    Outside `jit`, the function runs in NumPy, because a single evaluation is faster than compiling.
    """
    xp = array_namespace(lines, a, b)
    lines = jax.tree.map(xp.asarray, lines)
    baseline_vector = lines.centre_mm[..., b, :] - lines.centre_mm[..., a, :]
    baseline = xp.sqrt((baseline_vector**2).sum(-1))
    axis = baseline_vector / baseline[..., None]
    # Angle zero is the mean viewing direction, so the jump of 2 pi lies behind the cameras.
    view_direction = lines.matrix_px[..., a, 2, :3] + lines.matrix_px[..., b, 2, :3]
    first = view_direction - (view_direction * axis).sum(-1)[..., None] * axis
    first = first / xp.sqrt((first**2).sum(-1))[..., None]
    frame = xp.stack([axis, first, xp.cross(axis, first)], axis=-2)

    views = xp.stack([xp.asarray(a), xp.asarray(b)])
    homography = frame[..., None, :, :] @ lines.inverse[..., views, :, :]
    if lines.frame is None:
        homography = homography[:, None]
    else:
        homography = homography[lines.frame[views], xp.arange(2)[:, None]]
    # A segment in one plane with the baseline has infinite slopes, also under `jit`.
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = _pencil_columns(
            homography, lines.ends_px[views], lines.line[views, :, :2], lines.across_px2[views]
        )
    segments_of_views = PencilSegments(first), PencilSegments(second)
    return Pencil(frame, lines.centre_mm[..., a, :], baseline, *segments_of_views)


def take_pencil(
    planes: Pencil, lines: SegmentTable, view: Int[ArrayLike, ""], segment: Int[ArrayLike, "..."]
) -> Pencil:
    """Select the camera data of `planes` for each segment, if the frames are stacked.

    The frame, origin and baseline of the result have the axes of `segment`, one row for each
    segment. For a single frame, `planes` is returned unchanged. `view` is the first view of the
    pencil, `segment` the indices of segments in that view.
    """
    if lines.frame is None:
        return planes
    frame = lines.frame[view, segment]
    return planes._replace(
        frame=planes.frame[frame],
        origin_mm=planes.origin_mm[frame],
        baseline_mm=planes.baseline_mm[frame],
    )


def _pencil_columns(
    homography: Float[ArrayLike, "2 *n 3 3"],
    ends_px: Float[ArrayLike, "2 n 2 2"],
    line_normal: Float[ArrayLike, "2 n 2"],
    across_px2: Float[ArrayLike, "2 n 2 2"],
) -> Float[ArrayLike, "2 c n"]:
    """Compute the columns of `PencilSegments` for both views.

    `homography` maps homogeneous pixels to viewing rays in the frame of the pencil. `line_normal`
    is the unit normal of each segment in the image.
    """
    xp = array_namespace(homography, ends_px)
    rows = [vector3(homography[..., k, :]) for k in range(3)]
    # Leading axis of ends: (2, view, n).
    u, v = xp.moveaxis(ends_px, -1, 0).transpose(0, 3, 1, 2)
    x, y, z = (c0[None] * u + c1[None] * v + c2[None] for c0, c1, c2 in rows)
    first = xp.arctan2(z[0], y[0])
    turn = xp.arctan2(y[0] * z[1] - z[0] * y[1], y[0] * y[1] + z[0] * z[1])
    normal = cross3((x[0], y[0], z[0]), (x[1], y[1], z[1]))
    p, q = -normal[1] / normal[0], -normal[2] / normal[0]
    # An error across the segment moves the ray by `ray_across`. At a fixed plane angle this is a
    # change of slope. It also turns the end's plane, which equals a displacement along the segment.
    nu, nv = line_normal[..., 0], line_normal[..., 1]
    ray_across = [c0 * nu + c1 * nv for c0, c1, _ in rows]
    ray_along = [c0 * nv - c1 * nu for c0, c1, _ in rows[1:]]
    slope_push = (
        normal[0] * ray_across[0] + normal[1] * ray_across[1] + normal[2] * ray_across[2]
    ) / normal[0]
    slope_per_px = slope_push[None] / xp.sqrt(y * y + z * z)
    angle_across, angle_along = (
        y * w[1][None] - z * w[0][None] for w in (ray_across[1:], ray_along)
    )
    slide_per_px = angle_across / angle_along
    end_variance_across = xp.stack([across_px2[..., 0, 0], across_px2[..., 1, 1]])
    ends = (
        xp.stack([first, first + turn]),
        slope_per_px**2 * end_variance_across,
        slide_per_px**2 * end_variance_across,
    )
    is_swapped = turn[None] < 0
    angles, variance, end_variance = (xp.where(is_swapped, end[::-1], end) for end in ends)
    (low, high), cosine, sine = angles, xp.cos(angles), xp.sin(angles)
    unit = scaled3(normal, 1 / xp.sqrt(dot3(normal, normal)))
    slope_covariance = slope_per_px[0] * slope_per_px[1] * across_px2[..., 0, 1]
    columns = (
        *(low, high, cosine[0], sine[0], cosine[1], sine[1], p, q, *unit),
        *(variance[0], slope_covariance, variance[1], *end_variance),
    )
    return xp.stack(columns, axis=1)


def plane_angles(
    lines: SegmentTable, view: int, segments: PencilSegments
) -> Float[np.ndarray, "n 2"]:
    """Return the plane angles (low, high) of the segments of a view, (n, 2) rad.

    In a stack of frames, a multiple of 16 rad is added for each frame, so that the angles of
    different frames do not overlap.
    """
    angles = np.stack([np.asarray(segments.low), np.asarray(segments.high)], axis=1)
    if lines.frame is None:
        return angles
    # Angles lie within pi of zero, and a segment spans less than another pi.
    return angles + 16.0 * np.asarray(lines.frame)[view][:, None]


class CommonPart(NamedTuple):
    """Common part of one segment in each of two views, bounded by two epipolar planes.

    Attributes
    ----------
    low, high : ()
        Plane angles of the bounding planes, rad.
    at_low, at_high : (4,)
        Point of the line in space on each bounding plane. The values are the slope of the ray in
        the first view, cosine and sine of the plane angle, and inverse distance from the baseline,
        1/mm.
    possible : ()
        True if the common part exists and lies in front of both cameras.
    """

    low: Scalar
    high: Scalar
    at_low: tuple[Scalar, Scalar, Scalar, Scalar]
    at_high: tuple[Scalar, Scalar, Scalar, Scalar]
    possible: Bool[ArrayLike, "..."]


def cut_pair(
    baseline_mm: Scalar, a: PencilSegments, b: PencilSegments, tuning: CandidateTuning
) -> CommonPart:
    """Return the common part of a segment `a` of the first view and a segment `b` of the second
    view.
    """
    xp = array_namespace(a.low, b.low)
    low, high = xp.maximum(a.low, b.low), xp.minimum(a.high, b.high)
    shorter = xp.minimum(a.high - a.low, b.high - b.low)
    a_sets_low, a_sets_high = a.low > b.low, a.high < b.high

    def on_plane(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar, Scalar, Scalar]:
        slope = a.p * cosine + a.q * sine
        return slope, cosine, sine, (slope - b.p * cosine - b.q * sine) / baseline_mm

    at_low = on_plane(
        xp.where(a_sets_low, a.cosine_low, b.cosine_low),
        xp.where(a_sets_low, a.sine_low, b.sine_low),
    )
    at_high = on_plane(
        xp.where(a_sets_high, a.cosine_high, b.cosine_high),
        xp.where(a_sets_high, a.sine_high, b.sine_high),
    )
    possible = (high - low > tuning.smallest_overlap * shorter) & (at_low[3] > 0) & (at_high[3] > 0)
    return CommonPart(low, high, at_low, at_high, possible)


def common_ends_mm(planes: Pencil, part: CommonPart) -> tuple[Vector3, Vector3]:
    """Return the ends of the common part of a pair in space, world frame."""

    def point(bounding_plane: tuple[Scalar, Scalar, Scalar, Scalar]) -> Vector3:
        in_frame = scaled3(bounding_plane[:3], 1 / bounding_plane[3])
        return add3(vector3(planes.origin_mm), times_matrix(planes.frame.mT, in_frame))

    return point(part.at_low), point(part.at_high)


def pairs_sharing_planes(
    lines: SegmentTable,
    views: Int[np.ndarray, "2"],
    planes: Pencil,
    rows: tuple[Int[np.ndarray, "n"], Int[np.ndarray, "m"]],
    pairs_at_once: int,
    ends_px: float | None = None,
) -> Iterator[tuple[Int[np.ndarray, "_p"], Int[np.ndarray, "_p"]]]:
    """Yield the pairs of segments that share epipolar planes, in blocks of about `pairs_at_once`.

    With `ends_px`, a pair must also have corresponding ends: the low ends of both segments, or the
    high ends, lie on one epipolar plane. An end may be off by `ends_px` along its segment.

    Parameters
    ----------
    lines : SegmentTable
        Segments of all views.
    views : (2,)
        Indices of the two views.
    planes : Pencil
        Pencil of the two views.
    rows : (n,) and (m,)
        Segments of the first view and of the second view to combine.
    pairs_at_once : int
        Approximate number of pairs of a block.
    ends_px : float, optional
        Largest displacement of an end along its segment.
    """
    first, second = (view_rows.astype(np.int32) for view_rows in rows)
    angles_of_views = [
        plane_angles(lines, int(view), segments)
        for view, segments in zip(views, (planes.first, planes.second), strict=True)
    ]
    if ends_px is None:
        range_pairs = [(angles_of_views[0][first], angles_of_views[1][second])]
    else:
        end_ranges = [
            end_angles(lines, int(view), segments, angles, ends_px)
            for view, segments, angles in zip(
                views, (planes.first, planes.second), angles_of_views, strict=True
            )
        ]
        range_pairs = [(end_ranges[0][first, end], end_ranges[1][second, end]) for end in range(2)]
    for end, (first_ranges, second_ranges) in enumerate(range_pairs):
        for block in blocks_of_overlapping(first_ranges, second_ranges, pairs_at_once):
            i, j = overlapping(first_ranges[block], second_ranges)
            i += block.start
            if end:
                # Pairs that agree at both ends were yielded for the low end.
                first_low, second_low = range_pairs[0][0][i], range_pairs[0][1][j]
                is_new = (first_low[:, 1] <= second_low[:, 0]) | (
                    second_low[:, 1] <= first_low[:, 0]
                )
                i, j = i[is_new], j[is_new]
            yield first[i], second[j]


def end_angles(
    lines: SegmentTable,
    view: int,
    segments: PencilSegments,
    angles: Float[np.ndarray, "n 2"],
    radius_px: float,
    sigmas: float = 4.0,
) -> Float[np.ndarray, "n 2 2"]:
    """Return an interval of the plane angle about both ends of each segment, (n, 2, 2) rad.

    The interval corresponds to `radius_px` along the segment, plus `sigmas` standard deviations of
    the end's position. `angles` is the result of `plane_angles`.
    """
    variance = np.stack([np.asarray(x) for x in segments.end_variance_px2], axis=1)
    span = (angles[:, 1] - angles[:, 0])[:, None]
    length = np.asarray(lines.length_px)[view, : len(angles), None]
    half_width = (radius_px + sigmas * np.sqrt(variance)) * span / length
    return np.stack([angles - half_width, angles + half_width], axis=2)
