"""Two ends in space that may meet: how their lines pass each other, and how far both stop short."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.numerics.vectors import cross_3d


class Passing(NamedTuple):
    """Where two lines pass each other; not finite for parallel ones.

    distance_mm : between the lines, along `unit` across both. sine : of their angle.
    gap_mm : from each end along its own direction to where the lines are nearest.
    """

    distance_mm: Float[np.ndarray, "p"]
    unit: Float[np.ndarray, "p 3"]
    sine: Float[np.ndarray, "p"]
    gap_mm: Float[np.ndarray, "p 2"]


def passing(
    point_mm: Float[np.ndarray, "p 3"],
    way: Float[np.ndarray, "p 3"],
    other_mm: Float[np.ndarray, "p 3"],
    other_way: Float[np.ndarray, "p 3"],
) -> Passing:
    """Pairs of lines, each by an end and a unit direction, in mm."""
    apart, normal = other_mm - point_mm, cross_3d(way, other_way)
    sine2 = (normal**2).sum(axis=1)
    sine = np.sqrt(sine2)
    with np.errstate(divide="ignore", invalid="ignore"):
        gaps = [(cross_3d(apart, along) * normal).sum(axis=1) / sine2 for along in (other_way, way)]
        distance, unit = (apart * normal).sum(axis=1) / sine, normal / sine[:, None]
    return Passing(distance, unit, sine, np.stack(gaps, axis=1))


def log_gap_density(
    gap_px: Float[np.ndarray, "p 2"],
    px_per_mm: Float[np.ndarray, "p 2"],
    scales_px: Float[np.ndarray, "k"],
) -> Float[np.ndarray, "p k"]:
    """Log density, per mm^2, of how far two ends stop from their junction: Gaussian, by scale."""
    square = (gap_px**2).sum(axis=1)[:, None]
    per_mm2 = px_per_mm.prod(axis=1)[:, None]
    return -0.5 * square / scales_px**2 + np.log(per_mm2 / (2 * np.pi * scales_px**2))
