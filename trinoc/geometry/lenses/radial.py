"""The radial part of a distortion, and where it folds back and the picture ends."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class RadialPart(NamedTuple):
    """A ray at r from the optical axis is imaged at the radius r N(r^2) / D(r^2).

    Fields
    ------
    numerator, denominator : coefficients of N and D, the highest power of r^2 first, the last 1.
    by_angle : whether r is the angle from the axis, in rad, or its tangent.
    """

    numerator: Float[np.ndarray, "n"]
    denominator: Float[np.ndarray, "d"]
    by_angle: bool

    @property
    def fold(self) -> float:
        """The smallest r at which the radius stops to grow, or D is 0; infinite without one."""
        above, below = self.numerator, self.denominator
        # Coefficients near zero put the fold beyond what floats hold.
        with np.errstate(all="ignore"):
            slope = np.polymul(above, below)
            change = np.polysub(
                np.polymul(np.polyder(above), below), np.polymul(above, np.polyder(below))
            )
            slope = np.polyadd(slope, np.polymul([2.0, 0.0], change))
            return float(np.sqrt(min(_smallest_root(slope), _smallest_root(below))))

    def radius(self, r: float) -> float:
        """r N(r^2) / D(r^2)."""
        with np.errstate(all="ignore"):
            return float(
                r * np.polyval(self.numerator, r * r) / np.polyval(self.denominator, r * r)
            )


def _smallest_root(polynomial: Float[np.ndarray, "k"]) -> float:
    """The smallest positive real root; infinite without one."""
    polynomial = np.where(np.abs(polynomial) < 1e-30, 0.0, polynomial)
    roots = np.roots(polynomial)
    positive = (np.abs(roots.imag) <= 1e-9 * np.abs(roots)) & (roots.real > 0)
    return float(roots.real[positive].min(initial=np.inf))
