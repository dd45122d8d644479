"""3-D segments with joint covariance, and measures of them with standard deviations.

The errors have two parts: noise of each segment's fragments, and errors of the cameras that all
segments share.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike, in_float64
from trinoc.numerics.values import Value


class Measure(NamedTuple):
    """Value of a measured quantity and its standard deviation, in the same unit."""

    value: float
    sigma: float


class UncertainLines(Value):
    """3-D segments with the joint covariance of all their ends.

    The covariance has two parts: noise of each segment's fragments, and camera errors, which all
    segments share.

    Attributes
    ----------
    ends_mm : (t, 2, 3)
        Ends in the world frame.
    fragment_covariance_mm2 : (t, 6, 6)
        Part of each segment's covariance that comes from the noise of its fragments.
    by_parameters : (t, 6, k)
        Derivative of the ends by the camera parameters.
    parameter_covariance : (k, k)
        Covariance of the camera parameters.
    """

    ends_mm: Float[np.ndarray, "t 2 3"]
    fragment_covariance_mm2: Float[np.ndarray, "t 6 6"]
    by_parameters: Float[np.ndarray, "t 6 k"]
    parameter_covariance: Float[np.ndarray, "k k"]

    def __len__(self) -> int:
        return len(self.ends_mm)

    @property
    def shared_covariance_mm2(self) -> Float[np.ndarray, "t 6 6"]:
        """Part of each segment's covariance that comes from the camera errors, (t, 6, 6)."""
        by = self.by_parameters
        return np.einsum("tik,kl,tjl->tij", by, self.parameter_covariance, by, optimize=True)

    @property
    def covariance_mm2(self) -> Float[np.ndarray, "t 6 6"]:
        """Covariance of the ends of each segment, fragment noise plus camera errors, (t, 6, 6)."""
        return self.fragment_covariance_mm2 + self.shared_covariance_mm2

    def joint_covariance_mm2(self, segments: Sequence[int]) -> Float[np.ndarray, "n n"]:
        """Joint covariance (n, n) of the ends of several segments, n = 6 per segment.

        `segments` are the indices of the segments, in the order of the rows.
        """
        indices = np.asarray(segments)
        by = self.by_parameters[indices].reshape(6 * len(indices), -1)
        covariance = by @ self.parameter_covariance @ by.T
        for block, segment in enumerate(indices):
            rows = slice(6 * block, 6 * block + 6)
            covariance[rows, rows] += self.fragment_covariance_mm2[segment]
        return covariance

    def measure(self, function: Callable[..., Float[ArrayLike, ""]], *segments: int) -> Measure:
        """Compute a quantity of one or more segments and its standard deviation.

        Parameters
        ----------
        function : callable
            Differentiable JAX function of the ends (2, 3) of each segment, such as `length_mm` or
            `angle_deg`.
        *segments : int
            Indices of the segments, one per argument of `function`.

        Returns
        -------
        Measure
            Value and standard deviation, in the unit of `function`.

        Notes
        -----
        The standard deviation is propagated to first order. Examples: `lines.measure(length_mm,
        3)`, `lines.measure(angle_deg, 3, 7)`.
        """
        return _measure(function, self.ends_mm[list(segments)], self.joint_covariance_mm2(segments))


@in_float64
def _measure(
    function: Callable[..., Float[ArrayLike, ""]], ends_mm: np.ndarray, covariance: np.ndarray
) -> Measure:
    value, gradient = jax.value_and_grad(lambda ends: function(*ends))(jnp.asarray(ends_mm))
    row = gradient.reshape(-1)
    return Measure(float(value), float(jnp.sqrt(row @ covariance @ row)))


def length_mm(segment: Float[ArrayLike, "2 3"]) -> Float[ArrayLike, ""]:
    """Length of a 3-D segment, mm: the distance between its ends (2, 3)."""
    return _norm(segment[1] - segment[0])


def angle_deg(
    first: Float[ArrayLike, "2 3"], second: Float[ArrayLike, "2 3"]
) -> Float[ArrayLike, ""]:
    """Angle between the lines of two 3-D segments with ends (2, 3), from 0 to 90 degrees."""
    a, b = first[1] - first[0], second[1] - second[0]
    return jnp.degrees(jnp.arctan2(_norm(jnp.cross(a, b)), jnp.abs(a @ b)))


def distance_mm(
    first: Float[ArrayLike, "2 3"], second: Float[ArrayLike, "2 3"]
) -> Float[ArrayLike, ""]:
    """Distance of the second segment's midpoint from the line of the first segment, mm.

    For parallel edges of a body this is the distance between them. Both arguments are ends (2, 3).
    """
    direction = (first[1] - first[0]) / _norm(first[1] - first[0])
    across = [
        offset - (offset @ direction) * direction
        for offset in (second[0] - first[0], second[1] - first[0])
    ]
    return _norm((across[0] + across[1]) / 2)


def _norm(vector: Float[ArrayLike, "3"]) -> Float[ArrayLike, ""]:
    return jnp.sqrt(vector @ vector)
