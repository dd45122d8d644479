"""Distances between points and segments in space."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_CHUNK = 2048
_WHOLE_STEP = 1e-6


class NearestSegment(NamedTuple):
    """Of each point: the nearest segment (-1 where there is none), where on it the nearest place
    is (0 at its first end, 1 at its second), and the distance (infinite where there is none)."""

    segment: Int[np.ndarray, "n"]
    position: Float[np.ndarray, "n"]
    distance_mm: Float[np.ndarray, "n"]


class LengthsNear(NamedTuple):
    """Of points along segments: how far off the nearest of others is (infinite where there is
    none), and the length that each point stands for."""

    distance_mm: Float[np.ndarray, "k"]
    length_mm: Float[np.ndarray, "k"]

    def share_within(self, tolerance_mm: float) -> float:
        """Share of the length that is no farther off than that; 0 where there is no length."""
        total = float(self.length_mm.sum())
        near = float(self.length_mm[self.distance_mm <= tolerance_mm].sum())
        return near / total if total > 0 else 0.0


def measure_near_lengths(
    segments_mm: Float[np.ndarray, "n 2 3"], others_mm: Float[np.ndarray, "m 2 3"], step_mm: float
) -> LengthsNear:
    """How near segments are to the nearest of the others, sampled every `step_mm`."""
    points, length = sampled_segments(segments_mm, step_mm)
    return LengthsNear(distance_to_segments_mm(points, others_mm), length)


def sampled_segments(
    segments_mm: Float[np.ndarray, "n 2 3"], step_mm: float
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Points along segments, at least two on each, and the length that each stands for."""
    length = np.linalg.norm(segments_mm[:, 1] - segments_mm[:, 0], axis=1)
    # What rounding does to a length of whole steps must not change the number of points.
    count = np.maximum(2, np.floor(length / step_mm + _WHOLE_STEP).astype(np.int64) + 1)
    owner = np.repeat(np.arange(len(segments_mm)), count)
    place = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    position = ((place + 0.5) / count[owner])[:, None]
    first, second = segments_mm[owner, 0], segments_mm[owner, 1]
    return first + position * (second - first), (length / count)[owner]


def distance_to_segments_mm(
    points_mm: Float[np.ndarray, "n 3"], segments_mm: Float[np.ndarray, "m 2 3"]
) -> Float[np.ndarray, "n"]:
    """Distance of each point from the nearest of the segments; infinite where there is none."""
    return nearest_segments(points_mm, segments_mm).distance_mm


def nearest_segments(
    points_mm: Float[np.ndarray, "n 3"], segments_mm: Float[np.ndarray, "m 2 3"]
) -> NearestSegment:
    """The nearest of the segments to each point."""
    count = len(points_mm)
    nearest = NearestSegment(np.full(count, -1), np.zeros(count), np.full(count, np.inf))
    if len(segments_mm) == 0:
        return nearest
    first, along = segments_mm[:, 0], segments_mm[:, 1] - segments_mm[:, 0]
    squared = np.maximum(np.sum(along**2, axis=1), 1e-30)
    for start in range(0, count, _CHUNK):
        points = points_mm[start : start + _CHUNK]
        offset = points @ along.T - np.sum(first * along, axis=1)
        position = np.clip(offset / squared, 0.0, 1.0)
        # |x - a - t d|^2 by its terms, so that no (points, segments, 3) array is made.
        from_first = np.sum(points**2, axis=1)[:, None] - 2 * points @ first.T
        from_first += np.sum(first**2, axis=1)
        distance = from_first - 2 * position * offset + position**2 * squared
        best = distance.argmin(axis=1)
        row = np.arange(len(points))
        here = slice(start, start + len(points))
        nearest.segment[here] = best
        nearest.position[here] = position[row, best]
        nearest.distance_mm[here] = np.sqrt(np.maximum(distance[row, best], 0.0))
    return nearest
