"""Distances between points and 3-D segments."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

_CHUNK = 2048
_WHOLE_STEP = 1e-6


class NearestSegment(NamedTuple):
    """For each of n points, the nearest one of several 3-D segments.

    Attributes
    ----------
    segment : (n,)
        Index of the nearest segment; -1 if there are no segments.
    position : (n,)
        Position along the segment of its point nearest to the query point: 0 at the first end, 1 at
        the second end.
    distance_mm : (n,)
        Distance of the query point from the segment; infinite if there are no segments.
    """

    segment: Int[np.ndarray, "n"]
    position: Float[np.ndarray, "n"]
    distance_mm: Float[np.ndarray, "n"]


class LengthsNear(NamedTuple):
    """Distances of sample points on segments from the nearest of other segments.

    Attributes
    ----------
    distance_mm : (k,)
        Distance of each sample point; infinite if there are no other segments.
    length_mm : (k,)
        Length of the piece of segment that each sample point represents.
    """

    distance_mm: Float[np.ndarray, "k"]
    length_mm: Float[np.ndarray, "k"]

    def share_within(self, tolerance_mm: float) -> float:
        """Share of the total length, 0 to 1, with a distance of at most `tolerance_mm`.

        0 if the total length is 0.
        """
        total_mm = float(self.length_mm.sum())
        near_mm = float(self.length_mm[self.distance_mm <= tolerance_mm].sum())
        return near_mm / total_mm if total_mm > 0 else 0.0


def measure_near_lengths(
    segments_mm: Float[np.ndarray, "n 2 3"], others_mm: Float[np.ndarray, "m 2 3"], step_mm: float
) -> LengthsNear:
    """Sample segments every `step_mm` and measure the distances from the nearest of `others_mm`."""
    points, length = sampled_segments(segments_mm, step_mm)
    return LengthsNear(distance_to_segments_mm(points, others_mm), length)


def sampled_segments(
    segments_mm: Float[np.ndarray, "n 2 3"], step_mm: float
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k"]]:
    """Sample points on segments: (points (k, 3), length that each point represents (k,)), mm.

    Points are about `step_mm` apart; each segment has at least two.
    """
    length = np.linalg.norm(segments_mm[:, 1] - segments_mm[:, 0], axis=1)
    # The small term keeps rounding from changing the number of points.
    count = np.maximum(2, np.floor(length / step_mm + _WHOLE_STEP).astype(np.int64) + 1)
    owner = np.repeat(np.arange(len(segments_mm)), count)
    sample = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    position = ((sample + 0.5) / count[owner])[:, None]
    first, second = segments_mm[owner, 0], segments_mm[owner, 1]
    return first + position * (second - first), (length / count)[owner]


def distance_to_segments_mm(
    points_mm: Float[np.ndarray, "n 3"], segments_mm: Float[np.ndarray, "m 2 3"]
) -> Float[np.ndarray, "n"]:
    """Distance of each point from the nearest segment, (n,) mm; infinite without segments."""
    return nearest_segments(points_mm, segments_mm).distance_mm


def nearest_segments(
    points_mm: Float[np.ndarray, "n 3"], segments_mm: Float[np.ndarray, "m 2 3"]
) -> NearestSegment:
    """Find the nearest segment of each point."""
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
        # |x - a - t d|^2 by its terms, which avoids a (points, segments, 3) array.
        from_first = np.sum(points**2, axis=1)[:, None] - 2 * points @ first.T
        from_first += np.sum(first**2, axis=1)
        distance = from_first - 2 * position * offset + position**2 * squared
        best = distance.argmin(axis=1)
        row = np.arange(len(points))
        block = slice(start, start + len(points))
        nearest.segment[block] = best
        nearest.position[block] = position[row, best]
        nearest.distance_mm[block] = np.sqrt(np.maximum(distance[row, best], 0.0))
    return nearest
