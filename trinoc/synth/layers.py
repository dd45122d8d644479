"""What lies on the sheet, one layer over the other, as grey levels on the plane Z = 0."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.synth.coverage import coverage_of_cells, coverage_of_points
from trinoc.synth.shapes import Shape


@runtime_checkable
class Layer(Protocol):
    """Something that changes the grey levels below it."""

    @property
    def local(self) -> bool:
        """Whether nothing changes outside the box round the outline's image."""
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
        """The figure's grey where it lies, what was below elsewhere."""
        level = self.shape.level_mm(points_mm)
        share = coverage_of_cells(level) if cells else coverage_of_points(level)
        return grey + share * (self.grey - grey)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The figure's outline."""
        return self.shape.outline_mm(step_mm)
