"""Interpretation planes of segments of several views, and where these begin and end along a line.

Columns have the axis of views in front, that of the points (or of a segment's ends) next, and those
of the items, if any, last: one program for all views and points, and long loops over items.
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

# One number for each view, each view and point, or each point; and of each item.
OfViews = Float[ArrayLike, "v *h"]
OfPoints = Float[ArrayLike, "v e *h"]


class SegmentPlanes(NamedTuple):
    """One segment in each of some views, with what is needed of its camera and of clutter.

    matrix_px, centre_mm : of the cameras, the same for all items or of each. line, ends_px,
    length_px, rays : as in SegmentTable. variance_px2 : (c00, c01, c11) of the ends across it.
    log_clutter, typical_px : as in ClutterModel, about each segment and of its frame.
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
    """The planes through a camera's centre and a segment, at points near them.

    normal : unit normals. distance_mm : signed distance of each point from each plane.
    px_per_mm : image displacement across the segment per mm along `normal`, at each point.
    interval : place of each point along the segment, 0 at its first end and 1 at its second.
    image_px : of each point.
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
    """The rows of segments, one in each view; those of one item are of one frame."""
    xp = array_namespace(lines, clutter, segments)
    view = views.reshape(-1, *(1 for _ in segments.shape[1:]))
    typical = xp.asarray(clutter.typical_px)
    if lines.frame is None:
        camera, typical = view, typical.reshape(view.shape[1:])
    else:
        frame = lines.frame[views[0], segments[0]]
        camera, typical = (frame[None], view), typical[frame]
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
        typical[None],
    )


def interpretation_planes(sight: SegmentPlanes, points_mm: Vector3) -> InterpretationPlanes:
    """The interpretation plane of each segment at points in space, (e, *h) of each coordinate."""
    matrix, line = sight.matrix_px, vector3(sight.line)
    gradient = times_matrix(matrix[..., :3].mT, line)
    steepness = array_namespace(gradient).sqrt(dot3(gradient, gradient))
    image, depth = image_of_point(matrix[:, None], in_front(points_mm))
    # Along the segment is a quarter turn from its normal, which points to its right.
    du, dv = line[1] / sight.length_px, -line[0] / sight.length_px
    u0, v0 = sight.ends_px[..., 0, 0], sight.ends_px[..., 0, 1]
    across = line[0][:, None] * image[0] + line[1][:, None] * image[1] + line[2][:, None]
    along = (image[0] - u0[:, None]) * du[:, None] + (image[1] - v0[:, None]) * dv[:, None]
    px_per_mm = steepness[:, None] / depth
    normal = scaled3(gradient, 1 / steepness)
    return InterpretationPlanes(normal, across / px_per_mm, px_per_mm, along, image)


def variance_mm2(sight: SegmentPlanes, planes: InterpretationPlanes, e: int, f: int) -> OfViews:
    """Covariance of the distances of two points from each plane, due to the segments' errors."""
    place, px_per_mm = planes.interval, planes.px_per_mm
    covariance = interpolated_covariance(sight.variance_px2, place[:, e], place[:, f])
    return covariance / (px_per_mm[:, e] * px_per_mm[:, f])


def image_length_px(planes: InterpretationPlanes) -> OfViews:
    """Distance of the images of the first two points."""
    u, v = planes.image_px
    return array_namespace(u).sqrt((u[:, 1] - u[:, 0]) ** 2 + (v[:, 1] - v[:, 0]) ** 2)


def extents_on_line(
    sight: SegmentPlanes, origin: Vector3, along: Vector3
) -> tuple[OfViews, OfViews]:
    """(low, high) positions on a line in space (unit direction), in mm, nearest to the rays of
    both ends of each segment."""
    along = in_front(along)
    centre = add3(vector3(sight.centre_mm), in_front(origin), -1.0)
    along_centre = dot3(along, centre)

    def position(e: int) -> OfViews:
        ray = vector3(sight.rays[..., e, :])
        ray_ray, ray_along = dot3(ray, ray), dot3(ray, along)
        return (along_centre * ray_ray - ray_along * dot3(ray, centre)) / (
            ray_ray - ray_along * ray_along
        )

    first, second = position(0), position(1)
    xp = array_namespace(first)
    return xp.minimum(first, second), xp.maximum(first, second)
