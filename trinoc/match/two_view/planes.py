"""Interpretation planes of segments of several views, and the interval of each segment along a
line.

The axes of all columns are: views, points (or ends of a segment), items. One program serves any
number of views and points.
"""

from typing import NamedTuple

from jaxtyping import Float, Int

from trinoc.geometry.projection import image_of_point
from trinoc.match.observations.clutter import ClutterModel
from trinoc.match.observations.table import SegmentTable
from trinoc.numerics.precision import ArrayLike, array_namespace
from trinoc.numerics.vectors import (
    Vector3,
    add3,
    dot3,
    in_front,
    interpolated_covariance,
    scaled3,
    times_matrix,
    vector3,
)

# One number per view and item, or per view, point and item.
OfViews = Float[ArrayLike, "v *h"]
OfPoints = Float[ArrayLike, "v e *h"]


class SegmentPlanes(NamedTuple):
    """One segment in each of v views, for each of h candidates, with camera and clutter data.

    Attributes
    ----------
    matrix_px, centre_mm : (v, 3, 4) and (v, 3)
        Cameras of the views. In a stack, those of each candidate.
    line, ends_px, length_px, rays : (v, h, ...)
        As in SegmentTable.
    variance_px2 : three of (v, h)
        Variances and covariance (c00, c01, c11) of the two ends across the segment.
    log_clutter : (v, h)
        `ClutterModel.log_density` of each segment.
    typical_px : (1,)
        `ClutterModel.typical_px`. In a stack, that of each candidate.
    """

    matrix_px: Float[ArrayLike, "v *_h 3 4"]
    centre_mm: Float[ArrayLike, "v *_h 3"]
    line: Float[ArrayLike, "v *h 3"]
    ends_px: Float[ArrayLike, "v *h 2 2"]
    length_px: OfViews
    variance_px2: tuple[OfViews, OfViews, OfViews]
    rays: Float[ArrayLike, "v *h 2 3"]
    log_clutter: OfViews
    typical_px: Float[ArrayLike, "1 *_h"]


class InterpretationPlanes(NamedTuple):
    """Interpretation planes of segments, with their distances from given points in space.

    An interpretation plane contains a camera's centre and a segment.

    Attributes
    ----------
    normal : three of (v, h)
        Coordinates of the unit normals, world frame.
    distance_mm : (v, e, h)
        Signed distance of each point from each plane.
    px_per_mm : (v, e, h)
        Image displacement across the segment for a displacement of the point along `normal`.
    interval : (v, e, h)
        Position of each point's image along the segment, 0 at its first end and 1 at its second.
    image_px : two of (v, e, h)
        Image (u, v) of each point.
    """

    normal: tuple[OfViews, OfViews, OfViews]
    distance_mm: OfPoints
    px_per_mm: OfPoints
    interval: OfPoints
    image_px: tuple[OfPoints, OfPoints]


def segment_planes(
    lines: SegmentTable,
    clutter: ClutterModel,
    views: Int[ArrayLike, "v"],
    segments: Int[ArrayLike, "v *h"],
) -> SegmentPlanes:
    """Collect the data of the candidates' segments, one segment in each of the given views.

    In a stack of frames, all segments of a candidate belong to one frame.
    """
    xp = array_namespace(lines, clutter, segments)
    view = views.reshape(-1, *(1 for _ in segments.shape[1:]))
    typical_px = xp.asarray(clutter.typical_px)
    if lines.frame is None:
        camera, typical_px = view, typical_px.reshape(view.shape[1:])
    else:
        frame = lines.frame[views[0], segments[0]]
        camera, typical_px = (frame[None], view), typical_px[frame]
    across = lines.across_px2
    entries = across[..., 0, 0], across[..., 0, 1], across[..., 1, 1]
    c00, c01, c11 = (entry[view, segments] for entry in entries)
    return SegmentPlanes(
        lines.matrix_px[camera],
        lines.centre_mm[camera],
        lines.line[view, segments],
        lines.ends_px[view, segments],
        lines.length_px[view, segments],
        (c00, c01, c11),
        lines.rays[view, segments],
        xp.asarray(clutter.log_density)[view, segments],
        typical_px[None],
    )


def interpretation_planes(segments: SegmentPlanes, points_mm: Vector3) -> InterpretationPlanes:
    """Compute the interpretation plane of each segment, and its distances from points in space.

    Each coordinate of `points_mm` is (e, h): e points for each candidate.
    """
    matrix, line = segments.matrix_px, vector3(segments.line)
    gradient = times_matrix(matrix[..., :3].mT, line)
    steepness = array_namespace(gradient).sqrt(dot3(gradient, gradient))
    image, depth = image_of_point(matrix[:, None], in_front(points_mm))
    # The direction of the segment is its normal turned by 90 degrees; the normal points right.
    du, dv = line[1] / segments.length_px, -line[0] / segments.length_px
    u0, v0 = segments.ends_px[..., 0, 0], segments.ends_px[..., 0, 1]
    distance_px = line[0][:, None] * image[0] + line[1][:, None] * image[1] + line[2][:, None]
    position = (image[0] - u0[:, None]) * du[:, None] + (image[1] - v0[:, None]) * dv[:, None]
    px_per_mm = steepness[:, None] / depth
    normal = scaled3(gradient, 1 / steepness)
    return InterpretationPlanes(normal, distance_px / px_per_mm, px_per_mm, position, image)


def variance_mm2(segments: SegmentPlanes, planes: InterpretationPlanes, e: int, f: int) -> OfViews:
    """Return the covariance of the distances of points e and f from each plane, (v, h) mm^2.

    The covariance follows from the errors of the segments.
    """
    interval, px_per_mm = planes.interval, planes.px_per_mm
    covariance = interpolated_covariance(segments.variance_px2, interval[:, e], interval[:, f])
    return covariance / (px_per_mm[:, e] * px_per_mm[:, f])


def image_length_px(planes: InterpretationPlanes) -> OfViews:
    """Return the distance between the images of the first two points in each view, (v, h)."""
    u, v = planes.image_px
    return array_namespace(u).sqrt((u[:, 1] - u[:, 0]) ** 2 + (v[:, 1] - v[:, 0]) ** 2)


def extents_on_line(
    segments: SegmentPlanes, origin: Vector3, direction: Vector3
) -> tuple[OfViews, OfViews]:
    """Return the interval (low, high) of each segment on a line in space, (v, h) mm each.

    The ends of the interval are the points of the line nearest to the viewing rays of the segment's
    ends. Positions are measured from `origin` along the unit vector `direction`.
    """
    direction = in_front(direction)
    centre = add3(vector3(segments.centre_mm), in_front(origin), -1.0)
    centre_position = dot3(direction, centre)

    def position(e: int) -> OfViews:
        ray = vector3(segments.rays[..., e, :])
        ray_ray, ray_along = dot3(ray, ray), dot3(ray, direction)
        return (centre_position * ray_ray - ray_along * dot3(ray, centre)) / (
            ray_ray - ray_along * ray_along
        )

    first, second = position(0), position(1)
    xp = array_namespace(first)
    return xp.minimum(first, second), xp.maximum(first, second)
