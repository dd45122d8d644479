"""A segment's interpretation plane, and where it begins and ends along a line in space."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.match.observations import SegmentTable
from trinoc.numerics import (
    ArrayLike,
    Scalar,
    Vector2,
    Vector3,
    add3,
    between,
    dot3,
    scaled3,
    vector3,
)


class InterpretationPlane(NamedTuple):
    """The plane through a camera's centre and a segment, at two points near it.

    normal : unit normal. distance_mm : signed distance of each point from the plane.
    variance_mm2 : (s00, s01, s11) of these distances, due to the segment's errors.
    px_per_mm : image displacement across the segment per mm along `normal`, at each point.
    interval : place of each point along the segment, 0 at its first end and 1 at its second.
    length_px : distance of the points' images.
    """

    normal: Vector3
    distance_mm: tuple[Scalar, Scalar]
    variance_mm2: tuple[Scalar, Scalar, Scalar]
    px_per_mm: tuple[Scalar, Scalar]
    interval: tuple[Scalar, Scalar]
    length_px: Scalar


def interpretation_plane(
    lines: SegmentTable,
    view: Int[ArrayLike, ""],
    segment: Int[ArrayLike, ""],
    points_mm: tuple[Vector3, Vector3],
) -> InterpretationPlane:
    """The interpretation plane of one segment at two points in space."""
    matrix, line = lines.matrix_px[view], vector3(lines.line[view, segment])
    ends, length = lines.ends_px[view, segment], lines.length_px[view, segment]
    gradient = scaled3(vector3(matrix[0, :3]), line[0])
    gradient = add3(gradient, vector3(matrix[1, :3]), line[1])
    gradient = add3(gradient, vector3(matrix[2, :3]), line[2])
    steepness = jnp.sqrt(dot3(gradient, gradient))
    # Along the segment is a quarter turn from its normal, which points to its right.
    du, dv = line[1] / length, -line[0] / length

    def at(point: Vector3) -> tuple[Scalar, Scalar, Scalar, Vector2]:
        (u, v), depth = image_of(matrix, point)
        interval = (u - ends[0, 0]) * du + (v - ends[0, 1]) * dv
        return line[0] * u + line[1] * v + line[2], steepness / depth, interval, (u, v)

    first, second = at(points_mm[0]), at(points_mm[1])
    across = lines.across_px2[view, segment]
    own = (across[0, 0], across[0, 1], across[1, 1])
    (u0, v0), (u1, v1) = first[3], second[3]
    return InterpretationPlane(
        scaled3(gradient, 1 / steepness),
        (first[0] / first[1], second[0] / second[1]),
        (
            between(own, first[2], first[2]) / first[1] ** 2,
            between(own, first[2], second[2]) / (first[1] * second[1]),
            between(own, second[2], second[2]) / second[1] ** 2,
        ),
        (first[1], second[1]),
        (first[2], second[2]),
        jnp.sqrt((u1 - u0) ** 2 + (v1 - v0) ** 2),
    )


def image_of(matrix: Float[ArrayLike, "3 4"], point: Vector3) -> tuple[Vector2, Scalar]:
    """(undistorted pixel, depth) of a point, for a matrix whose third row gives the depth."""
    u, v, depth = (dot3(vector3(matrix[k, :3]), point) + matrix[k, 3] for k in range(3))
    return (u / depth, v / depth), depth


def extent_on_line(
    lines: SegmentTable,
    view: Int[ArrayLike, ""],
    segment: Int[ArrayLike, ""],
    origin: Vector3,
    along: Vector3,
) -> tuple[Scalar, Scalar]:
    """Positions on a line in space (unit direction), in mm, nearest to the rays of both ends."""
    centre = add3(vector3(lines.centre_mm[view]), origin, -1.0)

    def position(e: int) -> Scalar:
        ray = vector3(lines.rays[view, segment, e])
        ray_ray, ray_along, along_centre = dot3(ray, ray), dot3(ray, along), dot3(along, centre)
        return (along_centre * ray_ray - ray_along * dot3(ray, centre)) / (
            ray_ray - ray_along * ray_along
        )

    return position(0), position(1)
