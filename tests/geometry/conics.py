"""The image of a circle in closed form, a reference for the package's formula.

A dual conic C* holds the lines tangent to a conic: l^T C* l = 0. Under a homography H it
becomes H C* H^T (Hartley and Zisserman, result 2.14), and its product with the line at
infinity is the conic's centre, so that neither needs an inverse.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry.camera import Camera, projection_matrix
from trinoc.numerics.precision import ArrayLike, ScalarLike


def pixel_from_sheet_homography(camera: Camera) -> Float[ArrayLike, "3 3"]:
    """Homography of the sheet Z = 0 to undistorted pixels: columns 1, 2 and 4 of K [R | t]."""
    return projection_matrix(camera)[:, jnp.array([0, 1, 3])]


def dual_conic_of_circle(
    centre: Float[ArrayLike, "2"], radius: ScalarLike
) -> Float[ArrayLike, "3 3"]:
    """Dual conic of a circle: C* = c c^T - r^2 diag(1, 1, 0), with c = (centre, 1)."""
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
