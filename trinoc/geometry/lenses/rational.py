"""OpenCV's rational distortion, without and with its thin prism.

Source: OpenCV, "Camera Calibration and 3D Reconstruction", the model of `cv2.projectPoints`; the
quotient is that of D. Claus and A. Fitzgibbon, "A rational function lens distortion model", CVPR
2005.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens, ray_of_normalised
from trinoc.geometry.lenses.newton import inverse_in_plane
from trinoc.geometry.lenses.radial import RadialPart
from trinoc.numerics import ArrayLike

_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_POWERS = (2, 4, 1, 1, 6, 2, 4, 6)


class Rational(AbstractLens):
    """Radial distortion as a quotient of two cubics in r^2, with tangential (p1, p2)."""

    model: ClassVar[str] = "rational"
    coefficient_names: ClassVar[tuple[str, ...]] = _RATIONAL
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = _POWERS
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5, 8)
    dispensable: ClassVar[tuple[str, ...]] = ("k6", "k5", "k4", "k3", "k2")

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """The ideal (x/z, y/z), moved by quotient and tangential part."""
        return distort(ray_cam[:2] / ray_cam[2], self.coefficients)

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """(x, y, 1), by Newton's method."""
        coefficients = self.coefficients
        ideal = inverse_in_plane(lambda ideal: distort(ideal, coefficients), distorted)
        return ray_of_normalised(ideal)

    def radial_part(self) -> RadialPart:
        """The quotient."""
        return _radial_part(np.asarray(self.coefficients, dtype=np.float64))


class ThinPrism(AbstractLens):
    """`Rational` with OpenCV's thin prism: (s1 r^2 + s2 r^4, s3 r^2 + s4 r^4) besides."""

    model: ClassVar[str] = "thin_prism"
    coefficient_names: ClassVar[tuple[str, ...]] = (*_RATIONAL, "s1", "s2", "s3", "s4")
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (*_POWERS, 1, 3, 1, 3)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5, 8, 12)
    dispensable: ClassVar[tuple[str, ...]] = (
        *("s4", "s2", "s3", "s1"),
        *("k6", "k5", "k4", "k3", "k2"),
    )

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """The ideal (x/z, y/z), moved by quotient, tangential part and prism."""
        return distort_by_prism(ray_cam[:2] / ray_cam[2], self.coefficients)

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """(x, y, 1), by Newton's method."""
        coefficients = self.coefficients
        ideal = inverse_in_plane(lambda ideal: distort_by_prism(ideal, coefficients), distorted)
        return ray_of_normalised(ideal)

    def radial_part(self) -> RadialPart:
        """The quotient."""
        return _radial_part(np.asarray(self.coefficients, dtype=np.float64))


def distort(
    ideal: Float[ArrayLike, "2"], coefficients: Float[ArrayLike, "c"]
) -> Float[ArrayLike, "2"]:
    """(x/z, y/z) of an ideal pinhole to those of the lens, by the first eight coefficients."""
    x, y = ideal[0], ideal[1]
    k1, k2, p1, p2, k3, k4, k5, k6 = (coefficients[i] for i in range(8))
    r2 = x * x + y * y
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    radial = above / below
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )


def distort_by_prism(
    ideal: Float[ArrayLike, "2"], coefficients: Float[ArrayLike, "12"]
) -> Float[ArrayLike, "2"]:
    """The same by all twelve."""
    s1, s2, s3, s4 = (coefficients[i] for i in range(8, 12))
    r2 = ideal[0] * ideal[0] + ideal[1] * ideal[1]
    prism = jnp.stack([r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4)])
    return distort(ideal, coefficients) + prism


def _radial_part(coefficients: Float[np.ndarray, "c"]) -> RadialPart:
    k1, k2, _, _, k3, k4, k5, k6 = coefficients[:8]
    above, below = np.array([k3, k2, k1, 1.0]), np.array([k6, k5, k4, 1.0])
    return RadialPart(above, below, by_angle=False)
