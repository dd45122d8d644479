"""The printed sheet: what the ink covers, how much light paper and ink give back, the table."""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.numerics import ScalarLike
from trinoc.synth.camera_picture.surfaces import Cylinder, Surface
from trinoc.synth.camera_picture.table import Table
from trinoc.synth.layers import Layer
from trinoc.synth.shapes import ConvexPolygon
from trinoc.synth.sheet_image import PrintedSheet, sheet_layers


class Paper(eqx.Module):
    """A printed sheet as it came out of the printer and lies on a table.

    Fields
    ------
    surface : how it lies.
    print_scale : printed over nominal length along X and along Y.
    ink_gain_mm : by which ink reaches beyond the drawing.
    paper, ink, table : reflectances, the share of the light that comes back.
    size_mm : width and height of the sheet, centred on the origin.
    """

    surface: Surface = Cylinder()
    print_scale: tuple[ScalarLike, ScalarLike] = (1.0, 1.0)
    ink_gain_mm: float = 0.0
    paper: float = 0.85
    ink: float = 0.09
    table: float = 0.3
    size_mm: tuple[float, float] = (210.0, 297.0)

    def layers(self, pattern: PrintedSheet) -> tuple[Layer, ...]:
        """Table, paper and ink as reflectances, in the nominal millimetres of the layout."""
        nominal = (self.size_mm[0] / self.print_scale[0], self.size_mm[1] / self.print_scale[1])
        sheet = ConvexPolygon.rectangle(np.zeros(2), (float(nominal[0]), float(nominal[1])))
        inked = InkedLayout.of(pattern, self.ink_gain_mm)
        return (Table(sheet, self.table), *sheet_layers(inked, paper=self.paper, ink=self.ink))


class InkedLayout(eqx.Module):
    """A layout as ink fills it; the fields mean what `PrintedSheet`'s do."""

    centres_mm: Float[np.ndarray, "n 2"]
    radius_mm: Float[np.ndarray, "n"]
    inner_radius_mm: Float[np.ndarray, "n"]
    line_width_mm: float
    line_half_length_mm: tuple[float, float]
    line_style: str
    line_gap_mm: float

    @classmethod
    def of(cls, pattern: PrintedSheet, gain_mm: float) -> "InkedLayout":
        """The layout with every edge of ink moved outwards by `gain_mm`.

        Lines that are white inside circles stay as wide as they were drawn.
        """
        holes = pattern.inner_radius_mm
        wider = 2 * gain_mm if pattern.line_width_mm > 0 and pattern.line_style != "white" else 0.0
        along_x, along_y = pattern.line_half_length_mm
        # The white between circle and line shrinks by both edges, the circle's being in already.
        gap = pattern.line_gap_mm - (2 * gain_mm if pattern.line_style == "stop" else 0.0)
        return cls(
            centres_mm=pattern.centres_mm,
            radius_mm=pattern.radius_mm + gain_mm,
            inner_radius_mm=np.where(holes > 0, np.maximum(holes - gain_mm, 0.0), 0.0),
            line_width_mm=pattern.line_width_mm + wider,
            line_half_length_mm=(along_x + gain_mm, along_y + gain_mm),
            line_style=pattern.line_style,
            line_gap_mm=max(gap, 0.0),
        )
