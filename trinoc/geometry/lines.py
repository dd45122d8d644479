"""Lines of a picture and lines in space.

A picture line is l = (a, b, c) with a u + b v + c = 0, scaled to a^2 + b^2 = 1 where a
distance is meant. Distances are in pixels, points in undistorted pixels.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike


def line_through(
    first: Float[ArrayLike, "2"], second: Float[ArrayLike, "2"]
) -> Float[ArrayLike, "3"]:
    """Line through two points, with unit normal; positive distance is to the right of the
    direction from first to second as seen on the picture (v down)."""
    direction = second - first
    direction = direction / jnp.sqrt(direction @ direction)
    normal = jnp.stack([-direction[1], direction[0]])
    return jnp.append(normal, -(normal @ first))


def signed_distance(
    line: Float[ArrayLike, "3"], point: Float[ArrayLike, "2"]
) -> Float[ArrayLike, ""]:
    """Distance of a point from a line with unit normal, signed by the side."""
    return line[:2] @ point + line[2]


def plane_of_line(
    matrix_px: Float[ArrayLike, "3 4"], line: Float[ArrayLike, "3"]
) -> Float[ArrayLike, "4"]:
    """Plane through the camera's centre and a picture line, P^T l (Hartley and Zisserman, 8.2)."""
    return matrix_px.T @ line


def line_of_planes(
    first: Float[ArrayLike, "4"], second: Float[ArrayLike, "4"]
) -> tuple[Float[ArrayLike, "3"], Float[ArrayLike, "3"]]:
    """(point, unit direction) of the line in which two planes meet.

    The point is the one nearest the origin. NaN for parallel planes.
    """
    direction = jnp.cross(first[:3], second[:3])
    squared = direction @ direction
    point = jnp.cross(direction, second[3] * first[:3] - first[3] * second[:3]) / squared
    return -point, direction / jnp.sqrt(squared)
