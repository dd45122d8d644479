"""Layers on the sheet, one over the other, as grey levels on the plane Z = 0."""

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from simulation.camera_picture.shapes import Capsule, ConvexPolygon, Shape


@runtime_checkable
class Layer(Protocol):
    """Something that changes the grey levels below it."""

    @property
    def local(self) -> bool:
        """True if nothing changes outside the box round the outline's image."""
        ...

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The grey levels with this layer on top, at points of the sheet.

        With `cells` the points are (m, s, s, 2) the centres of adjoining cells, and the grey
        levels are means over the cells.
        """
        ...

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """Points along every sharp edge of the layer, at most `step_mm` apart."""
        ...


class Paint(eqx.Module):
    """A figure in one opaque grey."""

    shape: Shape
    grey: float

    @property
    def local(self) -> bool:
        """True: nothing outside the figure changes."""
        return True

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The figure's grey inside the figure, the given grey levels elsewhere."""
        share = coverage_share(self.shape, points_mm, cells=cells)
        return grey + share * (self.grey - grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The figure's outline."""
        return self.shape.outline_mm(step_mm)


def cover_card(
    centre_mm: Sequence[float] | np.ndarray,
    *,
    turn_deg: float = 0.0,
    size_mm: tuple[float, float] = (85.6, 54.0),
    grey: float = 0.55,
) -> Paint:
    """A bank card that lies on the sheet, turned by `turn_deg` from X toward Y."""
    return Paint(ConvexPolygon.rectangle(np.array(centre_mm), size_mm, turn_deg), grey)


def finger(
    tip_mm: Sequence[float] | np.ndarray,
    direction_deg: float,
    *,
    length_mm: float = 200.0,
    width_mm: float = 17.0,
    grey: float = 0.45,
) -> Paint:
    """A finger from its tip toward the hand, in `direction_deg` from X toward Y."""
    angle = np.radians(direction_deg)
    along = np.array([np.cos(angle), np.sin(angle)])
    start = np.array(tip_mm) + width_mm / 2 * along
    ends = np.stack([start, start + length_mm * along])
    return Paint(Capsule(ends, width_mm / 2), grey)


def coverage_share(
    shape: Shape, points_mm: Float[np.ndarray, "*n 2"], *, cells: bool
) -> Float[np.ndarray, "*n"]:
    """Share that a figure covers of the cells round points, see `Layer.over`, or of the points."""
    level = shape.level_mm(points_mm)
    return coverage_of_cells(level) if cells else coverage_of_points(level)


def coverage_of_points(level: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    """Coverage of points: 1 if the level is below zero; 0 otherwise, also for NaN."""
    return (level < 0).astype(np.float64)


def coverage_of_cells(level: Float[np.ndarray, "m s s"]) -> Float[np.ndarray, "m s s"]:
    """Share of each square cell where the level is below zero; 0 where the level is NaN.

    Exact where the boundary is straight within the cell: then the level over the cell is the
    sum of two uniform variables, as wide as the level changes along each side, and the share
    is their distribution function at zero.
    """
    low, high = level.min(axis=(1, 2)), level.max(axis=(1, 2))
    # A boundary further from the centres than they differ among themselves cuts no cell.
    cut = (2 * low < high) & (2 * high > low)
    share = coverage_of_points(level)
    share[cut] = _share(level[cut])
    return share


def _share(level: Float[np.ndarray, "m s s"]) -> Float[np.ndarray, "m s s"]:
    down, across = (np.abs(change) for change in np.gradient(level, axis=(1, 2)))
    wide = np.maximum(np.maximum(down, across), 1e-12)
    # Below this ratio the trapezium is a box to rounding, and its formula would lose digits.
    narrow = np.maximum(np.minimum(down, across), 1e-4 * wide)
    outer, inner = (wide + narrow) / 2, (wide - narrow) / 2
    share = _ramp(outer - level) - _ramp(inner - level)
    share += _ramp(-outer - level) - _ramp(-inner - level)
    share = np.nan_to_num(np.clip(share / (2 * wide * narrow), 0.0, 1.0))
    # Off the boundary, where the level may be even, the formula has no digits left.
    return np.where(np.abs(level) > outer, coverage_of_points(level), share)


def _ramp(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0.0) ** 2
