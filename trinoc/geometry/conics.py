"""Circles of the sheet and the ellipses that a camera makes of them.

A dual conic C* holds the lines tangent to a conic: l^T C* l = 0. Under a homography H it
becomes H C* H^T (Hartley and Zisserman, result 2.14), and its product with the line at
infinity is the conic's centre, so that neither needs an inverse.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.camera import Camera, pixel_from_sheet_homography, project
from trinoc.geometry.image_of_circle import centroid_of_region, circle_centre_offset
from trinoc.numerics import ArrayLike, ScalarLike

# Points at which a mapped ellipse is sampled: the centroid is then exact for what a lens does up
# to the second order in the ellipse's size, and good to 1e-7 px for what it does beyond.
_ANGLES_RAD = np.arange(8) * (2 * np.pi / 8)


def dual_conic_of_circle(
    centre: Float[ArrayLike, "2"], radius: ScalarLike
) -> Float[ArrayLike, "3 3"]:
    """C* = c c^T - r^2 diag(1, 1, 0), with c = (centre, 1)."""
    homogeneous = jnp.append(centre, 1.0)
    return jnp.outer(homogeneous, homogeneous) - radius**2 * jnp.diag(jnp.array([1.0, 1.0, 0.0]))


def transform_dual_conic(
    homography: Float[ArrayLike, "3 3"], dual_conic: Float[ArrayLike, "3 3"]
) -> Float[ArrayLike, "3 3"]:
    """Dual conic after a homography, H C* H^T."""
    return homography @ dual_conic @ homography.T


def centre_of_dual_conic(dual_conic: Float[ArrayLike, "3 3"]) -> Float[ArrayLike, "2"]:
    """Centre of a conic: the pole of the line at infinity, C* (0, 0, 1)^T."""
    return dual_conic[:2, 2] / dual_conic[2, 2]


def shape_of_dual_conic(dual_conic: Float[ArrayLike, "3 3"]) -> Float[ArrayLike, "2 2"]:
    """S of the ellipse (x - c)^T S^-1 (x - c) = 1; its eigenvalues are the squared semi-axes."""
    centre = centre_of_dual_conic(dual_conic)
    return jnp.outer(centre, jnp.asarray(centre)) - dual_conic[:2, :2] / dual_conic[2, 2]


def image_of_circle(
    camera: Camera, centre_sheet_mm: Float[ArrayLike, "2"], radius_mm: ScalarLike
) -> Float[ArrayLike, "3 3"]:
    """Dual conic, in undistorted pixels, of a circle on the sheet Z = 0."""
    circle = dual_conic_of_circle(centre_sheet_mm, radius_mm)
    return transform_dual_conic(pixel_from_sheet_homography(camera), circle)


def image_of_circle_centre(
    camera: Camera, centre_sheet_mm: Float[ArrayLike, "2"], radius_mm: ScalarLike
) -> Float[ArrayLike, "2"]:
    """Centre, in pixels of the picture, of the ellipse that images a circle of the sheet.

    This is not the image of the circle's centre: perspective moves it toward the camera's
    far side, by 0.09 px for the reference rig. With lens distortion the curve is no ellipse, and
    the centre is the centroid of what it encloses (`circle_centre_offset`).
    """
    if not camera.intrinsics.has_distortion:
        return centre_of_dual_conic(image_of_circle(camera, centre_sheet_mm, radius_mm))

    def image(place_mm: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return project(camera, jnp.append(place_mm, 0.0))

    return image(centre_sheet_mm) + circle_centre_offset(image, centre_sheet_mm, radius_mm)


def centre_of_mapped_ellipse(
    dual_conic: Float[ArrayLike, "3 3"],
    mapping: Callable[[Float[ArrayLike, "2"]], Float[ArrayLike, "2"]],
) -> Float[ArrayLike, "2"]:
    """Centroid of the region that a smooth mapping, such as a lens, makes of an ellipse.

    An ellipse fitted to the region's edge has its centre there, to 1e-4 px for common lenses.
    """
    return centroid_of_region(jax.vmap(mapping)(boundary_of_dual_conic(dual_conic, _ANGLES_RAD)))


def boundary_of_dual_conic(
    dual_conic: Float[ArrayLike, "3 3"], angles_rad: Float[ArrayLike, "n"]
) -> Float[ArrayLike, "n 2"]:
    """Points of an ellipse at given angles of the unit circle of which it is an affine image."""
    centre, shape = centre_of_dual_conic(dual_conic), shape_of_dual_conic(dual_conic)
    first = jnp.sqrt(shape[0, 0])
    slope = shape[0, 1] / first
    second = jnp.sqrt(shape[1, 1] - slope**2)
    cos, sin = jnp.cos(angles_rad), jnp.sin(angles_rad)
    return jnp.stack([centre[0] + first * cos, centre[1] + slope * cos + second * sin], axis=-1)
