"""Pinhole lens and OpenCV's polynomial models: Brown-Conrady, rational, and thin prism.

Brown-Conrady has OpenCV's first five coefficients, the rational model eight, the thin prism twelve.
Sources: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971;
OpenCV, "Camera Calibration and 3D Reconstruction", the model of `cv2.projectPoints`; for the
quotient D. Claus and A. Fitzgibbon, "A rational function lens distortion model", CVPR 2005.
"""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import (
    AFFINE_PARAMETERS,
    AbstractLens,
    AbstractPlaneLens,
    RadialPart,
    ray_of_normalised,
)
from trinoc.numerics.precision import ArrayLike


class Pinhole(AbstractLens):
    """A lens without distortion: images of straight lines are straight."""

    model: ClassVar[str] = "none"
    coefficient_names: ClassVar[tuple[str, ...]] = ()
    parameter_names: ClassVar[tuple[str, ...]] = AFFINE_PARAMETERS
    coefficient_powers: ClassVar[tuple[int, ...]] = ()
    coefficient_counts: ClassVar[tuple[int, ...]] = (0,)
    dispensable: ClassVar[tuple[str, ...]] = ()

    def distort(self, ray_cam: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (x/z, y/z) of a ray, (2,)."""
        return ray_cam[:2] / ray_cam[2]

    def undistort(self, distorted: Float[ArrayLike, "2"]) -> Float[ArrayLike, "3"]:
        """Ray (x, y, 1) of normalised coordinates (x, y)."""
        return ray_of_normalised(distorted)


class BrownConrady(AbstractPlaneLens):
    """A lens with radial (k1, k2, k3) and tangential (p1, p2) distortion of (x/z, y/z)."""

    model: ClassVar[str] = "brown_conrady"
    coefficient_names: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2", "k3")
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (2, 4, 1, 1, 6)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5)
    dispensable: ClassVar[tuple[str, ...]] = ("k3", "k2")

    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (2,) after radial and tangential distortion."""
        k1, k2, p1, p2, k3 = (self.coefficients[i] for i in range(5))
        r2 = ideal[0] * ideal[0] + ideal[1] * ideal[1]
        return radial_and_tangential(ideal, 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), p1, p2)

    def radial_part(self) -> RadialPart:
        """Radial part of the distortion, r (1 + k1 r^2 + k2 r^4 + k3 r^6), r = tan(angle).

        `tangential` is an upper bound on the derivative of the tangential part by r.
        """
        k1, k2, p1, p2, k3 = np.asarray(self.coefficients, dtype=np.float64).tolist()
        return RadialPart((k3, k2, k1, 1.0), tangential=(6 * math.hypot(p1, p2), 0.0))


def radial_and_tangential(
    ideal: Float[ArrayLike, "2"],
    radial: Float[ArrayLike, ""],
    p1: Float[ArrayLike, ""],
    p2: Float[ArrayLike, ""],
) -> Float[ArrayLike, "2"]:
    """Multiply normalised coordinates by the factor `radial`, add tangential distortion, (2,)."""
    x, y = ideal[0], ideal[1]
    along = radial + 2 * (p2 * x + p1 * y)
    return ideal * along + jnp.stack([p2, p1]) * (x * x + y * y)


_RATIONAL = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_POWERS = (2, 4, 1, 1, 6, 2, 4, 6)


class Rational(AbstractPlaneLens):
    """A lens whose radial distortion is a quotient of two cubics in r^2, with tangential p1, p2."""

    model: ClassVar[str] = "rational"
    coefficient_names: ClassVar[tuple[str, ...]] = _RATIONAL
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = _POWERS
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5, 8)
    dispensable: ClassVar[tuple[str, ...]] = ("k6", "k5", "k4", "k3", "k2")

    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (2,) after the radial quotient and tangential distortion."""
        return _by_quotient(ideal, self.coefficients)

    def radial_part(self) -> RadialPart:
        """Radial part of the distortion: r times the quotient of cubics in r^2, r = tan(angle).

        `tangential` is an upper bound on the derivative of the tangential part by r.
        """
        return _radial_part(np.asarray(self.coefficients, dtype=np.float64).tolist())


class ThinPrism(AbstractPlaneLens):
    """A `Rational` lens with OpenCV's thin-prism distortion added.

    The thin prism adds (s1 r^2 + s2 r^4, s3 r^2 + s4 r^4) to the distorted coordinates.
    """

    model: ClassVar[str] = "thin_prism"
    coefficient_names: ClassVar[tuple[str, ...]] = (*_RATIONAL, "s1", "s2", "s3", "s4")
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (*_POWERS, 1, 3, 1, 3)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5, 8, 12)
    dispensable: ClassVar[tuple[str, ...]] = (
        *("s4", "s2", "s3", "s1"),
        *("k6", "k5", "k4", "k3", "k2"),
    )

    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """Normalised coordinates (2,) after radial, tangential and thin-prism distortion."""
        s1, s2, s3, s4 = (self.coefficients[i] for i in range(8, 12))
        r2 = ideal[0] * ideal[0] + ideal[1] * ideal[1]
        prism = jnp.stack([r2 * (s1 + r2 * s2), r2 * (s3 + r2 * s4)])
        return _by_quotient(ideal, self.coefficients) + prism

    def radial_part(self) -> RadialPart:
        """Radial part of the distortion: r times the quotient of cubics in r^2, r = tan(angle).

        `tangential` is an upper bound on the derivative of tangential part and prism by r.
        """
        values = np.asarray(self.coefficients, dtype=np.float64).tolist()
        s1, s2, s3, s4 = values[8:]
        radial = _radial_part(values)
        prism = (4 * math.hypot(s2, s4), 0.0, radial.tangential[0] + 2 * math.hypot(s1, s3), 0.0)
        return radial._replace(tangential=prism)


def _by_quotient(
    ideal: Float[ArrayLike, "2"], coefficients: Float[ArrayLike, "c"]
) -> Float[ArrayLike, "2"]:
    """Normalised coordinates (2,) after the distortion of the rational model."""
    k1, k2, p1, p2, k3, k4, k5, k6 = (coefficients[i] for i in range(8))
    r2 = ideal[0] * ideal[0] + ideal[1] * ideal[1]
    above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    below = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
    return radial_and_tangential(ideal, above / below, p1, p2)


def _radial_part(coefficients: list[float]) -> RadialPart:
    k1, k2, p1, p2, k3, k4, k5, k6 = coefficients[:8]
    tangential = (6 * math.hypot(p1, p2), 0.0)
    return RadialPart((k3, k2, k1, 1.0), (k6, k5, k4, 1.0), tangential=tangential)
