"""Fisheye model of Kannala and Brandt: a polynomial in the angle from the optical axis.

Source: J. Kannala and S. S. Brandt, "A generic camera model and calibration method for
conventional, wide-angle, and fish-eye lenses", PAMI 28(8), 2006. The coefficients are those of
`cv2.fisheye`, and of "equidistant" in Kalibr and ROS.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens, RadialPart
from trinoc.geometry.lenses.newton import newton_iterations
from trinoc.numerics.precision import ArrayLike

_NEWTON_STEPS = 20
# numerical: a slope near zero would throw the next angle far beyond the lens.
_LEAST_SLOPE = 0.05
# Below this squared tangent of the angle, a series replaces the quotient of two small numbers.
_NEAR_AXIS = 1e-6


class KannalaBrandt(AbstractLens):
    """Fisheye lens with a polynomial in the angle t from the optical axis, up to t = 180 degrees.

    A ray at t has the image radius t (1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8), in focal lengths.
    """

    model: ClassVar[str] = "kannala_brandt"
    coefficient_names: ClassVar[tuple[str, ...]] = ("k1", "k2", "k3", "k4")
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (2, 4, 6, 8)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 3, 4)
    dispensable: ClassVar[tuple[str, ...]] = ("k4", "k3", "k2")
    zero_is_ideal: ClassVar[bool] = False
    newton: ClassVar[tuple[int, float]] = (_NEWTON_STEPS, _LEAST_SLOPE)

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Image point (2,) of a ray, in focal lengths from the principal point.

        The direction is that of (x, y); the distance is the polynomial in the angle.
        """
        across, forward = ray_cam[:2], ray_cam[2]
        square = across @ across
        angle_per_across = _angle_per_radius(square, forward)
        angle_square = square * angle_per_across**2
        return across * (angle_per_across * _radius_per_angle(angle_square, self.coefficients))

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Unit ray (3,) of an image point; its angle from the axis is found by Newton's method."""
        square = distorted @ distorted
        on_axis = square < 1e-30
        radius = jnp.sqrt(jnp.where(on_axis, 1.0, square))
        angle = _angle_of_radius(radius, self.coefficients)
        across = jnp.where(on_axis, 1.0, jnp.sin(angle) / radius) * distorted
        return jnp.concatenate([across, jnp.where(on_axis, 1.0, jnp.cos(angle))[None]])

    def radial_part(self) -> RadialPart:
        """Radial part of the distortion: the polynomial in the angle t (see the class)."""
        falling = np.asarray(self.coefficients, dtype=np.float64)[::-1].tolist()
        return RadialPart((*falling, 1.0), by_angle=True)


def _angle_per_radius(
    square: Float[ArrayLike, ""], forward: Float[ArrayLike, ""]
) -> Float[ArrayLike, ""]:
    """Angle from the axis divided by the distance a from the axis, atan2(a, z) / a, of a ray.

    `square` is a^2 = x^2 + y^2 and `forward` is z. The result is smooth on the optical axis, a = 0.
    """
    is_near_axis = (forward > 0) & (square < _NEAR_AXIS * forward * forward)
    safe = jnp.where(is_near_axis, 1.0, forward)
    across = jnp.sqrt(jnp.where(is_near_axis, 1.0, square))
    general = jnp.arctan2(across, safe) / across
    z = jnp.where(is_near_axis, forward, 1.0)
    q = jnp.where(is_near_axis, square, 0.0) / (z * z)
    return jnp.where(is_near_axis, (1 - q * (1 / 3 - q * (1 / 5 - q / 7))) / z, general)


def _radius_per_angle(
    angle_square: Float[ArrayLike, ""], coefficients: Float[ArrayLike, "4"]
) -> Float[ArrayLike, ""]:
    """Image radius divided by the angle t: 1 + k1 t^2 + k2 t^4 + k3 t^6 + k4 t^8.

    `angle_square` is t^2.
    """
    k1, k2, k3, k4 = (coefficients[i] for i in range(4))
    t2 = angle_square
    return 1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4)))


def _angle_of_radius(
    radius: Float[ArrayLike, ""], coefficients: Float[ArrayLike, "4"]
) -> Float[ArrayLike, ""]:
    """Angle from the axis, 0 to pi rad, of a ray with a given image radius, by Newton's method.

    `radius` is in focal lengths.
    """
    k1, k2, k3, k4 = (coefficients[i] for i in range(4))

    def step(_: ArrayLike, angle: Float[ArrayLike, ""]) -> Float[ArrayLike, ""]:
        t2 = angle * angle
        slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
        residual = angle * _radius_per_angle(t2, coefficients) - radius
        return jnp.clip(angle - residual / jnp.maximum(slope, _LEAST_SLOPE), 0.0, jnp.pi)

    return newton_iterations(step, jnp.clip(radius, 0.0, jnp.pi), _NEWTON_STEPS)
