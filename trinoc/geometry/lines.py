"""Lines of an image and lines in space.

An image line is l = (a, b, c) with a u + b v + c = 0, in undistorted pixels. Functions of distances
need a unit normal, a^2 + b^2 = 1.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike


def line_through(
    first: Float[ArrayLike, "2"], second: Float[ArrayLike, "2"]
) -> Float[ArrayLike, "3"]:
    """Line (a, b, c) through two image points, with unit normal, (3,).

    Parameters
    ----------
    first, second : (2,)
        Two different points, px.

    Returns
    -------
    (3,)
        Line with a u + b v + c = 0. Distances from it are positive on the right of the direction
        from `first` to `second`, as displayed (v down).
    """
    direction = second - first
    direction = direction / jnp.sqrt(direction @ direction)
    normal = jnp.stack([-direction[1], direction[0]])
    return jnp.append(normal, -(normal @ first))


def signed_distance(
    line: Float[ArrayLike, "3"], point: Float[ArrayLike, "2"]
) -> Float[ArrayLike, ""]:
    """Signed distance of an image point from a line (a, b, c) with unit normal, px.

    For a line of `line_through`, the distance is positive on the right of the direction from its
    first to its second point, as displayed (v down).
    """
    return line[:2] @ point + line[2]


def plane_of_line(
    matrix_px: Float[ArrayLike, "3 4"], line: Float[ArrayLike, "3"]
) -> Float[ArrayLike, "4"]:
    """Plane P^T l (4,) through the camera centre and a line of the image.

    Parameters
    ----------
    matrix_px : (3, 4)
        Projection matrix P of the camera.
    line : (3,)
        Line l in undistorted pixels.

    Returns
    -------
    (4,)
        Plane (n, d) with n . X + d = 0 in the world frame; n is not normalised.

    References
    ----------
    Hartley and Zisserman, "Multiple View Geometry" (2003), section 8.2.
    """
    return matrix_px.T @ line


def line_of_planes(
    first: Float[ArrayLike, "4"], second: Float[ArrayLike, "4"]
) -> tuple[Float[ArrayLike, "3"], Float[ArrayLike, "3"]]:
    """Intersection of two planes (n, d): (point (3,), unit direction (3,)).

    The point is the point of the line nearest to the origin. NaN for parallel planes.
    """
    direction = jnp.cross(first[:3], second[:3])
    squared = direction @ direction
    point = jnp.cross(direction, second[3] * first[:3] - first[3] * second[:3]) / squared
    return -point, direction / jnp.sqrt(squared)
