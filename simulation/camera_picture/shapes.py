"""Plane figures on the sheet Z = 0, in millimetres.

A figure has a level, the signed distance from its boundary or close to it, negative inside,
and gives its outline, so that a renderer knows which pixels an edge can cross. An outline may
hold more than the true boundary, never less.
"""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float


@runtime_checkable
class Shape(Protocol):
    """Interface of a plane figure for the renderer."""

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Level: negative inside, zero on the boundary; near the boundary, the distance in mm."""
        ...

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the boundary, neighbours at most `step_mm` apart."""
        ...


class FilledCircle(eqx.Module):
    """A full circle."""

    centre_mm: Float[np.ndarray, "2"]
    radius_mm: float

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Distance from the centre, less the radius."""
        offset = points_mm - self.centre_mm
        return np.hypot(offset[..., 0], offset[..., 1]) - self.radius_mm

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

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """The largest of the distances to the right of the sides."""
        x, y = points_mm[..., 0], points_mm[..., 1]
        level = np.full(points_mm.shape[:-1], -np.inf)
        for first, second in zip(self.corners_mm, np.roll(self.corners_mm, -1, 0), strict=True):
            along = (second - first) / np.hypot(*(second - first))
            level = np.maximum(level, along[1] * (x - first[0]) - along[0] * (y - first[1]))
        return level

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

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Distance from the segment, less the radius."""
        first, along = self.ends_mm[0], self.ends_mm[1] - self.ends_mm[0]
        position = np.clip((points_mm - first) @ along / (along @ along), 0.0, 1.0)
        offset = points_mm - first - position[..., None] * along
        return np.hypot(offset[..., 0], offset[..., 1]) - self.radius_mm

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along both sides and both round ends."""
        along = self.ends_mm[1] - self.ends_mm[0]
        across = self.radius_mm * np.array([-along[1], along[0]]) / np.hypot(*along)
        first, second = self.ends_mm
        sides = [_along(first + off, second + off, step_mm) for off in (across, -across)]
        rounds = [FilledCircle(end, self.radius_mm).outline_mm(step_mm) for end in self.ends_mm]
        return np.concatenate(sides + rounds)


class Intersection(eqx.Module):
    """Intersection of two figures."""

    first: Shape
    second: Shape

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """The larger of both levels."""
        return np.maximum(self.first.level_mm(points_mm), self.second.level_mm(points_mm))

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Both complete outlines, which contain the boundary."""
        first, second = self.first.outline_mm(step_mm), self.second.outline_mm(step_mm)
        return np.concatenate([first, second])


class Cells(eqx.Module):
    """Selected cells of a grid of lines along X and Y; touching cells have no seam.

    Chessboards, markers, grids of tags.

    Fields
    ------
    x_mm, y_mm : rising, the lines.
    inside : (rows, columns) which cells belong to the figure, the lowest row first, those before
        the first line and after the last among them.
    """

    x_mm: Float[np.ndarray, "n"]
    y_mm: Float[np.ndarray, "m"]
    inside: Bool[np.ndarray, "_r _c"]

    def level_mm(self, points_mm: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
        """Signed distance from the nearest cell of the other kind, at most the least cell width."""
        x, y = points_mm[..., 0], points_mm[..., 1]
        column, row = np.searchsorted(self.x_mm, x), np.searchsorted(self.y_mm, y)
        # Cells farther than the neighbours are no nearer than this: the level has no jump.
        far = min(float(np.diff(lines).min()) for lines in (self.x_mm, self.y_mm))
        lines_x = np.concatenate([[-np.inf], self.x_mm, [np.inf]])
        lines_y = np.concatenate([[-np.inf], self.y_mm, [np.inf]])
        across = {-1: x - lines_x[column], 0: 0.0 * x, 1: lines_x[column + 1] - x}
        along = {-1: y - lines_y[row], 0: 0.0 * y, 1: lines_y[row + 1] - y}
        around = np.pad(self.inside, 1, mode="edge")
        is_inside, distance = self.inside[row, column], np.full(x.shape, far)
        for down in (-1, 0, 1):
            for aside in (-1, 0, 1):
                unlike = around[row + 1 + down, column + 1 + aside] != is_inside
                away = np.hypot(across[aside], along[down])
                distance = np.where(unlike, np.minimum(distance, away), distance)
        return np.where(is_inside, -distance, distance)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along the sides between cells that are unlike."""
        upright = _sides(self.inside, self.x_mm, self.y_mm, step_mm)
        lying = _sides(self.inside.T, self.y_mm, self.x_mm, step_mm)
        return np.concatenate([upright, lying[:, ::-1]])


def _along(
    first: Float[np.ndarray, "2"], second: Float[np.ndarray, "2"], step_mm: float
) -> Float[np.ndarray, "k 2"]:
    count = max(2, int(np.ceil(np.hypot(*(second - first)) / step_mm)) + 1)
    return first + np.linspace(0.0, 1.0, count)[:, None] * (second - first)


def _sides(
    inside: Bool[np.ndarray, "_r _c"],
    x_mm: Float[np.ndarray, "n"],
    y_mm: Float[np.ndarray, "m"],
    step_mm: float,
) -> Float[np.ndarray, "k 2"]:
    rows, columns = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    points = [np.zeros((0, 2))]
    for row, column in zip(rows, columns, strict=True):
        low, high = y_mm[row], y_mm[row + 1]
        y = np.linspace(low, high, max(2, int(np.ceil((high - low) / step_mm)) + 1))
        points.append(np.stack([np.full(len(y), x_mm[column]), y], axis=1))
    return np.concatenate(points)
