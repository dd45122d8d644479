"""Image of a circle: the centre of the ellipse is not the image of the circle's centre.

One formula serves every smooth mapping from the plane of a circle to the image: a homography, a
lens with distortion, a bent board.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.camera import Camera, project
from trinoc.numerics.precision import ArrayLike, ScalarLike

# The image of an edge is smooth, so that its first harmonics determine the centroid: to 1e-11 px
# with so many points, for a circle of 25 mm seen obliquely from 250 mm.
_EDGE_POINTS = 12
_ANGLES_RAD = np.arange(_EDGE_POINTS) * (2 * np.pi / _EDGE_POINTS)
_CENTRE_AND_EDGE = np.r_[
    np.zeros((1, 2)), np.stack([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)], axis=1)
]


def image_of_circle_centre(
    camera: Camera, centre_sheet_mm: Float[ArrayLike, "2"], radius_mm: ScalarLike
) -> Float[ArrayLike, "2"]:
    """Centre (2,), px, of the ellipse that images a circle on the sheet Z = 0.

    This is not the image of the circle's centre.
    """

    def image(point_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return project(camera, jnp.append(point_mm, 0.0))

    return image(centre_sheet_mm) + circle_centre_offset(image, centre_sheet_mm, radius_mm)


def circle_centre_offset(
    mapping: Callable[[Float[ArrayLike, "2"]], Float[ArrayLike, "2"]],
    centre: Float[ArrayLike, "2"],
    radius: ScalarLike,
) -> Float[ArrayLike, "2"]:
    """Return the centroid of a disc's image minus the image of the disc's centre.

    Parameters
    ----------
    mapping : callable
        Maps a point (2,) of the circle's plane to a point (2,) of the image, usually px.
    centre : (2,)
        Centre of the circle in its plane.
    radius : scalar
        Radius in the unit of `centre`. The offset is 0 for a radius of 0.

    Returns
    -------
    (2,)
        Offset in the unit of the image.

    Notes
    -----
    An ellipse fitted to the edge of the image has its centre at the centroid, to 1e-4 px for common
    lenses.
    """
    is_circle = jnp.asarray(radius) > 0
    offset = _CENTRE_AND_EDGE.astype(jnp.result_type(centre))
    # A radius of 0 has no area to divide by: a derivative of what is not used stays finite.
    image = jax.vmap(mapping)(centre[None] + jnp.where(is_circle, radius, 1.0) * offset)
    return jnp.where(is_circle, centroid_of_region(image[1:] - image[:1]), 0.0)


def centroid_of_region(edge: Float[ArrayLike, "n 2"]) -> Float[ArrayLike, "2"]:
    """Centroid (2,) of the region inside a smooth closed curve.

    `edge` contains points of the curve at equidistant values of its parameter, once around. Green's
    theorem gives area and first moment from the points and their tangents. The mean of the points
    would be wrong, because the points are not equally dense along the curve.
    """
    mean = jnp.mean(edge, axis=0, keepdims=True)
    offset = edge - mean
    tangent = _trigonometric_derivative(len(edge)).astype(offset.dtype) @ offset
    # Green's theorem: twice the area, and three times its first moment.
    area = offset[:, 0] * tangent[:, 1] - offset[:, 1] * tangent[:, 0]
    return mean[0] + 2.0 / 3.0 * (area @ offset) / jnp.sum(area)


def _trigonometric_derivative(count: int) -> Float[np.ndarray, "n n"]:
    """Matrix (n, n) from values of a trigonometric polynomial to its derivatives.

    Values and derivatives are at the same n = `count` equidistant angles.
    """
    step = np.arange(count)[:, None] - np.arange(count)[None]
    cotangent = 1.0 / np.tan(np.pi * np.where(step == 0, 0.5, step) / count)
    return np.where(step == 0, 0.0, 0.5 * (-1.0) ** step * cotangent)
