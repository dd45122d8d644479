"""Brown-Conrady distortion, as OpenCV's first five coefficients describe it.

Source: D. C. Brown, "Close-range camera calibration", Photogrammetric Engineering 37(8), 1971.
"""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractPlaneLens, RadialPart
from trinoc.numerics.precision import ArrayLike


class BrownConrady(AbstractPlaneLens):
    """A lens with radial (k1, k2, k3) and tangential (p1, p2) distortion of (x/z, y/z)."""

    model: ClassVar[str] = "brown_conrady"
    coefficient_names: ClassVar[tuple[str, ...]] = ("k1", "k2", "p1", "p2", "k3")
    parameter_names: ClassVar[tuple[str, ...]] = (*AFFINE_PARAMETERS, *coefficient_names)
    coefficient_powers: ClassVar[tuple[int, ...]] = (2, 4, 1, 1, 6)
    coefficient_counts: ClassVar[tuple[int, ...]] = (0, 1, 2, 4, 5)
    dispensable: ClassVar[tuple[str, ...]] = ("k3", "k2")

    def distort_ideal(self, ideal: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        """The place after the polynomial."""
        k1, k2, p1, p2, k3 = (self.coefficients[i] for i in range(5))
        r2 = ideal[0] * ideal[0] + ideal[1] * ideal[1]
        return radial_and_tangential(ideal, 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), p1, p2)

    def radial_part(self) -> RadialPart:
        """r (1 + k1 r^2 + k2 r^4 + k3 r^6)."""
        k1, k2, _, _, k3 = np.asarray(self.coefficients, dtype=np.float64)
        return RadialPart(np.array([k3, k2, k1, 1.0]), np.ones(1), by_angle=False)


def radial_and_tangential(
    ideal: Float[ArrayLike, "2"],
    radial: Float[ArrayLike, ""],
    p1: Float[ArrayLike, ""],
    p2: Float[ArrayLike, ""],
) -> Float[ArrayLike, "2"]:
    """A place that is moved along its radius by a factor, and across it by p1 and p2."""
    x, y = ideal[0], ideal[1]
    r2 = x * x + y * y
    return jnp.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ]
    )
