"""Tracks that hold an outline of the round body below a rim."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.rims.circles import ENDS, Chords, Circles
from trinoc.match.tuning import RimTuning
from trinoc.numerics import cross_3d


def are_outlines(
    chords: Chords, circles: Circles, mm_per_px: float, tuning: RimTuning
) -> Bool[np.ndarray, "n"]:
    """Whether the rays of a segment's ends touch the cylinder over any of the circles, near it."""
    found = np.zeros(len(chords.view), dtype=bool)
    rays = chords.rays[:, ENDS]
    for centre, axis, radius in zip(*circles, strict=True):
        across = cross_3d(rays, axis)
        sine = np.maximum(np.linalg.norm(across, axis=2), 1e-9)
        off = (chords.centre_mm - centre)[:, None]
        distance = np.abs((off * across).sum(axis=2)) / sine
        height = abs_height(rays, off, axis)
        near = np.abs(distance - radius).max(axis=1) < tuning.outline_px * mm_per_px
        begins = height.min(axis=1) < tuning.outline_from * radius
        # From the rim down: a line across it does not leave its plane.
        leaves = height.max(axis=1) - height.min(axis=1) > tuning.outline_px * mm_per_px
        found |= near & begins & leaves & (height.max(axis=1) < tuning.outline_to * radius)
    return found


def abs_height(
    rays: Float[np.ndarray, "n e 3"],
    off_mm: Float[np.ndarray, "n 1 3"],
    axis: Float[np.ndarray, "3"],
) -> Float[np.ndarray, "n e"]:
    """How far from the circle's plane, along its axis, the rays pass nearest to the axis."""
    cosine = rays @ axis
    along, up = (rays * off_mm).sum(axis=2), off_mm @ axis
    depth = (cosine * up - along) / np.maximum(1 - cosine**2, 1e-12)
    return np.abs(up + depth * cosine)
