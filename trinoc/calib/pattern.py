"""The printed sheet: circles and crossed lines on the plane Z = 0."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

LINE_STYLES = ("stop", "through", "white")


class Pattern(eqx.Module):
    """Circles (discs or rings) and two crossed lines, in millimetres on the sheet Z = 0.

    The lines lie along X and Y and cross at the origin of the world.

    Fields
    ------
    name : what the sheet is called.
    centres_mm : (n, 2) centres (X, Y) of the circles.
    radius_mm : (n,) outer radius of each circle.
    inner_radius_mm : (n,) radius of the white hole of a ring; 0 for a full disc.
    lattice : (n, 2) integer lattice coordinates of each circle; neighbours in the lattice
        differ by one in one coordinate.
    line_width_mm : width of the crossed lines; 0 for a sheet without lines.
    line_half_length_mm : (2,) reach from the origin, to both sides, of the line along X and
        of the line along Y.
    line_style : where a line meets a circle it stops `line_gap_mm` before it ("stop"), runs
        through it in black ("through"), or runs through it in white ("white"). A line that
        passes between the rows meets none.
    line_gap_mm : distance at which a line of style "stop" ends before a circle.
    """

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "n 2"]
    radius_mm: Float[np.ndarray, "n"]
    inner_radius_mm: Float[np.ndarray, "n"]
    lattice: Int[np.ndarray, "n 2"]
    line_width_mm: float = eqx.field(static=True)
    line_half_length_mm: tuple[float, float] = eqx.field(static=True)
    line_style: str = eqx.field(static=True)
    line_gap_mm: float = eqx.field(static=True)

    def __len__(self) -> int:
        return len(self.centres_mm)
