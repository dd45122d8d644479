"""Geometry of two line ends in space that may meet at a junction."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.numerics.vectors import cross_3d


class ClosestApproach(NamedTuple):
    """Closest approach of two lines in space; the values of parallel lines are not finite.

    Attributes
    ----------
    distance_mm : (p,)
        Signed distance of the lines along `normal`.
    normal : (p, 3)
        Unit vector perpendicular to both lines.
    sine : (p,)
        Sine of the angle between the lines.
    gap_mm : (p, 2)
        Distance along each line, from its end to the point nearest to the other line. It is
        positive in the direction of the line.
    """

    distance_mm: Float[np.ndarray, "p"]
    normal: Float[np.ndarray, "p 3"]
    sine: Float[np.ndarray, "p"]
    gap_mm: Float[np.ndarray, "p 2"]


def closest_approach(
    point_mm: Float[np.ndarray, "p 3"],
    direction: Float[np.ndarray, "p 3"],
    other_mm: Float[np.ndarray, "p 3"],
    other_direction: Float[np.ndarray, "p 3"],
) -> ClosestApproach:
    """Compute the closest approach of p pairs of lines.

    `point_mm` and `direction` are an end and the unit direction of the first line of each pair.
    `other_mm` and `other_direction` are the end and the direction of the second line.
    """
    offset, normal = other_mm - point_mm, cross_3d(direction, other_direction)
    sine2 = (normal**2).sum(axis=1)
    sine = np.sqrt(sine2)
    with np.errstate(divide="ignore", invalid="ignore"):
        gaps_mm = [
            (cross_3d(offset, direction_across) * normal).sum(axis=1) / sine2
            for direction_across in (other_direction, direction)
        ]
        distance, unit = (offset * normal).sum(axis=1) / sine, normal / sine[:, None]
    return ClosestApproach(distance, unit, sine, np.stack(gaps_mm, axis=1))


def log_gap_density(
    gap_px: Float[np.ndarray, "p 2"],
    px_per_mm: Float[np.ndarray, "p 2"],
    scales_px: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "p k"]:
    """Log density of the gaps between two line ends and the junction of their lines, (p, k),
    1/mm^2.

    The gaps in pixels are assumed Gaussian with zero mean, with each of k standard deviations
    `scales_px`.
    """
    square = (gap_px**2).sum(axis=1)[:, None]
    per_mm2 = px_per_mm.prod(axis=1)[:, None]
    return -0.5 * square / scales_px**2 + np.log(per_mm2 / (2 * np.pi * scales_px**2))
