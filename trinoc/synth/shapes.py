"""Plane figures on the sheet Z = 0, in millimetres.

A figure says which points it contains, and gives its outline, so that a renderer knows which
pixels an edge can cross. An outline may hold more than the true boundary, never less.
"""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float


@runtime_checkable
class Shape(Protocol):
    """What a renderer asks of a plane figure."""

    def contains(self, points_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point lies in the figure."""
        ...

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the boundary, neighbours at most `step_mm` apart."""
        ...


class Disc(eqx.Module):
    """A full circle."""

    centre_mm: Float[np.ndarray, "2"]
    radius_mm: float

    def contains(self, points_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point lies in the disc."""
        offset = points_mm - self.centre_mm
        return offset[..., 0] ** 2 + offset[..., 1] ** 2 < self.radius_mm**2

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the circle."""
        count = max(8, int(np.ceil(2 * np.pi * self.radius_mm / step_mm)))
        angle = np.arange(count) * (2 * np.pi / count)
        return self.centre_mm + self.radius_mm * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


class ConvexPolygon(eqx.Module):
    """A convex polygon; corners in counter-clockwise order."""

    corners_mm: Float[np.ndarray, "k 2"]

    @classmethod
    def rectangle(
        cls, centre_mm: Float[np.ndarray, "2"], size_mm: tuple[float, float], turn_deg: float = 0.0
    ) -> "ConvexPolygon":
        """A rectangle of `size_mm` about its centre, turned counter-clockwise."""
        half = np.array(size_mm) / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
        return cls(centre_mm + half @ np.array([[cos, sin], [-sin, cos]]))

    def contains(self, points_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point lies to the left of every side."""
        x, y = points_mm[..., 0], points_mm[..., 1]
        inside = np.ones(points_mm.shape[:-1], dtype=bool)
        for first, second in zip(self.corners_mm, np.roll(self.corners_mm, -1, 0), strict=True):
            along = second - first
            inside &= along[0] * (y - first[1]) - along[1] * (x - first[0]) > 0
        return inside

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the sides."""
        following = np.roll(self.corners_mm, -1, axis=0)
        sides = [
            _along(first, second, step_mm)
            for first, second in zip(self.corners_mm, following, strict=True)
        ]
        return np.concatenate(sides)


class Capsule(eqx.Module):
    """All points within a radius of a segment: a finger, seen from above."""

    ends_mm: Float[np.ndarray, "2 2"]
    radius_mm: float

    def contains(self, points_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point is nearer than the radius to the segment."""
        first, along = self.ends_mm[0], self.ends_mm[1] - self.ends_mm[0]
        position = np.clip((points_mm - first) @ along / (along @ along), 0.0, 1.0)
        offset = points_mm - first - position[..., None] * along
        return offset[..., 0] ** 2 + offset[..., 1] ** 2 < self.radius_mm**2

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along both sides and both round ends."""
        along = self.ends_mm[1] - self.ends_mm[0]
        across = self.radius_mm * np.array([-along[1], along[0]]) / np.hypot(*along)
        first, second = self.ends_mm
        sides = [_along(first + off, second + off, step_mm) for off in (across, -across)]
        rounds = [Disc(end, self.radius_mm).outline_mm(step_mm) for end in self.ends_mm]
        return np.concatenate(sides + rounds)


class Intersection(eqx.Module):
    """What two figures share."""

    first: Shape
    second: Shape

    def contains(self, points_mm: Float[np.ndarray, "*n 2"]) -> Bool[np.ndarray, "*n"]:
        """Whether each point lies in both figures."""
        return self.first.contains(points_mm) & self.second.contains(points_mm)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Both outlines whole, which is more than the boundary."""
        first, second = self.first.outline_mm(step_mm), self.second.outline_mm(step_mm)
        return np.concatenate([first, second])


def _along(
    first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"], step_mm: float
) -> Float[np.ndarray, "k 2"]:
    count = max(2, int(np.ceil(np.hypot(*(second - first)) / step_mm)) + 1)
    return first + np.linspace(0.0, 1.0, count)[:, None] * (second - first)
