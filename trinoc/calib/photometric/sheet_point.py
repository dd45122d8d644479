"""Where the ray of a pixel meets the sheet, and how that point moves with the pixel."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics import ArrayLike


class Ray(NamedTuple):
    """A pixel after the lens: fixed while the pose moves, so it is computed once.

    Fields
    ------
    normalised : (2,) (x/z, y/z) of the pixel's centre in the camera frame.
    by_pixel : (2, 2) derivative of `normalised` with respect to (u, v).
    """

    normalised: Float[ArrayLike, "2"]
    by_pixel: Float[ArrayLike, "2 2"]

    def moved(self, du: Float[ArrayLike, ""], dv: Float[ArrayLike, ""]) -> "Ray":
        """The ray of a place (du, dv) pixels aside, by the lens's derivative here."""
        (xu, xv), (yu, yv) = self.by_pixel
        x, y = self.normalised[0], self.normalised[1]
        aside = jnp.stack([x + xu * du + xv * dv, y + yu * du + yv * dv])
        return Ray(aside, self.by_pixel)


class SheetPoint(NamedTuple):
    """A pixel's point on the sheet.

    Fields
    ------
    point_mm : (2,) (X, Y).
    by_pixel : (2, 2) A, derivative of the point with respect to (u, v), mm per px.
    depth_slope : (2,) w, derivative of the logarithm of the homogeneous coordinate, per px:
        the second derivatives of the point are -(A_ij w_k + A_ik w_j).
    by_matrix : (3,) ray / homogeneous coordinate, which carries a change of the homography:
        d point_i = (dM_i - point_i dM_2) . by_matrix, for rows M_i.
    unit : 1, used as a fusion barrier. XLA computes cheap elementwise values again at every use;
        dividing by a 1 that it cannot see through makes it compute them once.
    """

    point_mm: Float[ArrayLike, "2"]
    by_pixel: Float[ArrayLike, "2 2"]
    depth_slope: Float[ArrayLike, "2"]
    by_matrix: Float[ArrayLike, "3"]
    unit: Float[ArrayLike, ""]


def sheet_point(
    sheet_from_normalised: Float[ArrayLike, "3 3"], ray: Ray, unit: Float[ArrayLike, ""]
) -> SheetPoint:
    """The point of a ray under the homography M from normalised coordinates to the sheet.

    Written in scalars: over thousands of pixels the compiler fuses them into one loop, which
    it does not do for products of small matrices.
    """
    (m00, m01, m02), (m10, m11, m12), (m20, m21, m22) = sheet_from_normalised
    x, y = ray.normalised[0], ray.normalised[1]
    (xu, xv), (yu, yv) = ray.by_pixel
    scale = 1 / (m20 * x + m21 * y + m22)
    point_x = (m00 * x + m01 * y + m02) * scale
    point_y = (m10 * x + m11 * y + m12) * scale
    slope_x, slope_y = m20 * scale, m21 * scale
    a00, a01 = m00 * scale - point_x * slope_x, m01 * scale - point_x * slope_y
    a10, a11 = m10 * scale - point_y * slope_x, m11 * scale - point_y * slope_y
    return SheetPoint(
        jnp.stack([point_x, point_y]),
        jnp.stack(
            [
                jnp.stack([a00 * xu + a01 * yu, a00 * xv + a01 * yv]),
                jnp.stack([a10 * xu + a11 * yu, a10 * xv + a11 * yv]),
            ]
        ),
        jnp.stack([slope_x * xu + slope_y * yu, slope_x * xv + slope_y * yv]),
        jnp.stack([x * scale, y * scale, scale]),
        unit,
    )
