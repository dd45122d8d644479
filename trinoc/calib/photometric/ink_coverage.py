"""The share of a blurred pixel that is ink: circles, rings, and the crossed lines, or squares.

The part of the model that is differentiated takes a small displacement of the pixel's point
on the sheet: the edges' directions and curvatures stay as they are, which changes a row of
the Jacobian by a percent and the answer not at all.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.edges import (
    Coverage,
    Edge,
    circular_edge,
    common,
    coverage,
    opposite,
    straight_edge,
)
from trinoc.calib.photometric.kernels import Kernel, kernel_coverage
from trinoc.calib.photometric.sheet_point import Ray, SheetPoint
from trinoc.calib.photometric.square_coverage import Squares, ink_of_squares
from trinoc.numerics import ArrayLike

Scalar = Float[ArrayLike, ""]
# (displacement on the sheet X, Y in mm, ink spread in mm, sigma in px or kernel) -> share of ink.
InkShare = Callable[[Scalar, Scalar, Scalar, Scalar | Kernel], Scalar]
Band = tuple[Coverage, Coverage]
# The line style of boards of squares, which have no lines.
SQUARES = "squares"


class Drawing(NamedTuple):
    """What the compiler must know of the sheet: it makes the model as simple as the sheet is.

    Fields
    ------
    line_style : of the pattern; SQUARES for a board of squares.
    has_rings : whether some circle is a ring.
    """

    line_style: str
    has_rings: bool


class Circle(NamedTuple):
    """The circle nearest to a pixel.

    Fields
    ------
    centre_mm : (2,)
    radius_mm, inner_radius_mm : of the ink; the second is 0 for a full disc.
    present : 1, or 0 for a pixel that is near no circle.
    """

    centre_mm: Float[ArrayLike, "2"]
    radius_mm: Scalar
    inner_radius_mm: Scalar
    present: Scalar


class Cross(NamedTuple):
    """The crossed lines, in mm: half their width, their reach, and their gap at a circle."""

    half_width_mm: Scalar
    half_length_mm: Float[ArrayLike, "2"]
    gap_mm: Scalar


class View(NamedTuple):
    """A pixel on the sheet, from which edges can be looked at."""

    sheet_from_camera: Float[ArrayLike, "3 3"]
    ray: Ray
    point: SheetPoint

    def circle(self, circle: Circle, radius_mm: Scalar) -> Edge:
        """The edge of given radius about a circle's centre."""
        return circular_edge(
            self.sheet_from_camera, self.ray, self.point, circle.centre_mm, radius_mm
        )


def ink_near(
    view: View, figure: Circle | Squares, cross: Cross, drawing: Drawing, near_line: bool
) -> InkShare:
    """Ink of what is nearest to a pixel."""
    if isinstance(figure, Squares):
        return partial(ink_of_squares, view.point, figure)
    if near_line:
        return ink_of_sheet(view, figure, cross, drawing)
    return ink_of_circle(view, figure, drawing)


def ink_of_circle(view: View, circle: Circle, drawing: Drawing) -> InkShare:
    """Ink of a disc or ring; a hole lies wholly inside its disc, so shares subtract."""
    outer = view.circle(circle, circle.radius_mm)
    hole, has_hole = _hole(view, circle, drawing)

    def share(dx: Scalar, dy: Scalar, spread: Scalar, blur: Scalar | Kernel) -> Scalar:
        ink = circle.present * _coverage(outer, _shift(outer, dx, dy) - spread, blur).share
        if hole is None:
            return ink
        return ink - has_hole * _coverage(hole, _shift(hole, dx, dy) + spread, blur).share

    return share


def ink_of_sheet(view: View, circle: Circle, cross: Cross, drawing: Drawing) -> InkShare:
    """Ink of the crossed lines and the nearest circle, by how lines and circles meet."""
    outer = view.circle(circle, circle.radius_mm)
    hole, has_hole = _hole(view, circle, drawing)
    gap = view.circle(circle, circle.radius_mm + cross.gap_mm)
    rings = ink_of_circle(view, circle, drawing)
    point = view.point
    x, y = point.point_mm[0], point.point_mm[1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    side_x, side_y = jnp.where(x < 0, -one, one), jnp.where(y < 0, -one, one)
    half_width = cross.half_width_mm
    sides_x = _sides(point, zero, one, half_width)
    sides_y = _sides(point, one, zero, half_width)
    end_x = straight_edge(point, side_x, zero, cross.half_length_mm[0])
    end_y = straight_edge(point, zero, side_y, cross.half_length_mm[1])

    def share(dx: Scalar, dy: Scalar, spread: Scalar, blur: Scalar | Kernel) -> Scalar:
        def covered(edge: Edge, grown: Scalar) -> Coverage:
            return _coverage(edge, _shift(edge, dx, dy) - grown, blur)

        def band(sides: tuple[Edge, Edge], grown: Scalar) -> Band:
            return covered(sides[0], grown), covered(sides[1], grown)

        def lines_within(disc: Coverage, first: Band, second: Band) -> Scalar:
            crossing = _crossing(first, second) * disc.share
            return circle.present * (_within(first, disc) + _within(second, disc) - crossing)

        band_x, band_y = band(sides_x, spread), band(sides_y, spread)
        lines = _within(band_x, covered(end_x, spread)) + _within(band_y, covered(end_y, spread))
        circles, lines = rings(dx, dy, spread, blur), lines - _crossing(band_x, band_y)
        if drawing.line_style == "stop":
            return circles + lines - lines_within(covered(gap, -spread), band_x, band_y)
        disc = covered(outer, spread)
        black = lines - lines_within(disc, band_x, band_y)
        if drawing.line_style == "white":
            # Ink spreads into a white line from both sides.
            band_x, band_y = band(sides_x, -spread), band(sides_y, -spread)
            black = black - lines_within(disc, band_x, band_y)
        if hole is None:
            return circles + black
        return circles + black + has_hole * lines_within(covered(hole, -spread), band_x, band_y)

    return share


def _coverage(edge: Edge, shift_mm: Scalar, blur: Scalar | Kernel) -> Coverage:
    if isinstance(blur, Kernel):
        return kernel_coverage(edge, shift_mm, blur)
    return coverage(edge, shift_mm, blur)


def _shift(edge: Edge, dx: Scalar, dy: Scalar) -> Scalar:
    return edge.normal_x * dx + edge.normal_y * dy


def _sides(
    point: SheetPoint, normal_x: Scalar, normal_y: Scalar, half_width_mm: Scalar
) -> tuple[Edge, Edge]:
    """The two edges of a line through the origin."""
    above = straight_edge(point, normal_x, normal_y, half_width_mm)
    below = straight_edge(point, normal_x, normal_y, -half_width_mm)
    return above, opposite(below, -below.distance)


def _share(band: Band) -> Scalar:
    return band[0].share + band[1].share - 1


def _crossing(first: Band, second: Band) -> Scalar:
    return _within(first, second[0]) + _within(first, second[1]) - _share(first)


def _within(band: Band, other: Coverage) -> Scalar:
    return common(band[0], other) + common(band[1], other) - other.share


def _hole(view: View, circle: Circle, drawing: Drawing) -> tuple[Edge | None, Scalar]:
    """The edge of a ring's hole and 1, or some edge and 0 for a full disc."""
    if not drawing.has_rings:
        return None, jnp.zeros_like(circle.present)
    is_ring = circle.inner_radius_mm > 0
    radius = jnp.where(is_ring, circle.inner_radius_mm, circle.radius_mm)
    has_hole = jnp.where(is_ring, circle.present, jnp.zeros_like(circle.present))
    return view.circle(circle, radius), has_hole
