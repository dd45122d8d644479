"""The printed sheet: figures of ink, reflectances of paper and ink, and the table."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from simulation.camera_picture.layers import Layer, Paint, coverage_share
from simulation.camera_picture.shapes import ConvexPolygon, FilledCircle, Intersection, Shape
from simulation.camera_picture.surfaces import RolledPaper, Surface
from trinoc.numerics.precision import ScalarLike

# Wave numbers (rad/mm) across and along the grain, and phases: nothing repeats within a picture.
_GRAIN = np.array(
    [[0.31, 0.011, 0.3], [0.73, 0.017, 1.9], [1.27, -0.023, 4.1], [0.083, 0.006, 2.2]]
)


@runtime_checkable
class SheetFigures(Protocol):
    """Circles and crossed lines in mm on Z = 0, with fields as of `trinoc.Pattern`."""

    centres_mm: Float[np.ndarray, "n 2"]
    radius_mm: Float[np.ndarray, "n"]
    inner_radius_mm: Float[np.ndarray, "n"]
    line_width_mm: float
    line_half_length_mm: tuple[float, float]
    line_style: str
    line_gap_mm: float


class Paper(eqx.Module):
    """A printed sheet as it came out of the printer and lies on a table.

    Fields
    ------
    surface : how it lies.
    print_scale : printed over nominal length along X and along Y.
    ink_gain_mm : by which ink reaches beyond the drawing.
    paper, ink, table : reflectances, the share of the light that comes back; without a table the
        paper reaches to the horizon.
    size_mm : width and height of the sheet, centred on the origin.
    """

    surface: Surface = RolledPaper()
    print_scale: tuple[ScalarLike, ScalarLike] = (1.0, 1.0)
    ink_gain_mm: float = 0.0
    paper: float = 0.85
    ink: float = 0.09
    table: float | None = 0.3
    size_mm: tuple[float, float] = (210.0, 297.0)

    def layers(self, pattern: SheetFigures) -> tuple[Layer, ...]:
        """Table, paper and ink as reflectances, in the nominal millimetres of the layout."""
        printed = printed_layers(
            pattern, paper=self.paper, ink=self.ink, ink_gain_mm=self.ink_gain_mm
        )
        if self.table is None:
            return printed
        nominal = (self.size_mm[0] / self.print_scale[0], self.size_mm[1] / self.print_scale[1])
        sheet = ConvexPolygon.rectangle(np.zeros(2), (float(nominal[0]), float(nominal[1])))
        return (TableTop(sheet, self.table), *printed)


class TableTop(eqx.Module):
    """Wood outside a figure, its reflectance changing by a tenth along the grain."""

    sheet: Shape
    reflectance: float

    @property
    def local(self) -> bool:
        """False: it fills the picture."""
        return False

    def over(
        self,
        grey: Float[np.ndarray, "*n"],
        points_mm: Float[np.ndarray, "*n 2"],
        *,
        cells: bool = False,
    ) -> Float[np.ndarray, "*n"]:
        """The given grey levels inside the sheet, wood elsewhere."""
        share = coverage_share(self.sheet, points_mm, cells=cells)
        wood = np.full(grey.shape, self.reflectance)
        on_table = np.isfinite(points_mm).all(axis=-1) & (share < 1.0)
        phase = points_mm[on_table] @ _GRAIN[:, 1::-1].T + _GRAIN[:, 2]
        wood[on_table] *= 1 + 0.1 * np.mean(np.sin(phase), axis=-1)
        return wood + share * (grey - wood)

    def outline_mm(self, step_mm: float) -> Float[np.ndarray, "k 2"]:
        """The sheet's outline."""
        return self.sheet.outline_mm(step_mm)


def printed_layers(
    pattern: SheetFigures, *, paper: float, ink: float, ink_gain_mm: float = 0.0
) -> tuple[Layer, ...]:
    """The print as layers of paint, lowest first; all ink is grown by `ink_gain_mm`.

    Lines that are white inside circles stay as wide as they were drawn.
    """
    discs = [
        FilledCircle(centre, float(radius) + ink_gain_mm)
        for centre, radius in zip(pattern.centres_mm, pattern.radius_mm, strict=True)
    ]
    circles = [Paint(disc, ink) for disc in discs] + [
        Paint(FilledCircle(disc.centre_mm, float(inner) - ink_gain_mm), paper)
        for disc, inner in zip(discs, pattern.inner_radius_mm, strict=True)
        if inner > ink_gain_mm
    ]
    lines = _lines(pattern, ink_gain_mm)
    inked = [Paint(line, ink) for line in lines]
    if pattern.line_style == "through":
        return (*circles, *inked)
    crossed = [disc for disc in discs if _meets_a_line(pattern, disc)]
    if pattern.line_style == "white":
        white = [Paint(Intersection(line, disc), paper) for line in lines for disc in crossed]
        return (*inked, *circles, *white)
    # The white before a circle ends where the line's ink begins, which has come nearer as well.
    beyond = pattern.line_gap_mm - 2 * ink_gain_mm
    gaps = [Paint(FilledCircle(disc.centre_mm, disc.radius_mm + beyond), paper) for disc in crossed]
    return (*inked, *gaps, *circles)


def _lines(pattern: SheetFigures, ink_gain_mm: float) -> list[ConvexPolygon]:
    if not pattern.line_width_mm > 0:
        return []
    along_x, along_y = (2 * (half + ink_gain_mm) for half in pattern.line_half_length_mm)
    width = pattern.line_width_mm + (2 * ink_gain_mm if pattern.line_style != "white" else 0.0)
    return [
        ConvexPolygon.rectangle(np.zeros(2), (along_x, width)),
        ConvexPolygon.rectangle(np.zeros(2), (width, along_y)),
    ]


def _meets_a_line(pattern: SheetFigures, disc: FilledCircle) -> bool:
    """True if a line comes within the gap of a circle."""
    reach = disc.radius_mm + max(pattern.line_gap_mm, 0.0) + pattern.line_width_mm / 2
    return bool((np.abs(disc.centre_mm) < reach).any())
