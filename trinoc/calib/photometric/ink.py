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
    Edge,
    EdgeCoverage,
    Kernel,
    circular_edge,
    common,
    coverage,
    opposite,
    straight_edge,
)
from trinoc.calib.photometric.sheet_places import Ray, SheetPoint
from trinoc.numerics.precision import ArrayLike

Scalar = Float[ArrayLike, ""]
# (displacement on the sheet X, Y in mm, ink spread in mm, kernel) -> share of ink.
InkShare = Callable[[Scalar, Scalar, Scalar, Kernel], Scalar]
Band = tuple[EdgeCoverage, EdgeCoverage]
# What lies before a line of an edge whose ink has spread one way, and the other.
_SpreadSides = tuple[EdgeCoverage, EdgeCoverage]
# The line style of boards of squares, which have no lines.
SQUARES = "squares"


class InkDrawing(NamedTuple):
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


class Squares(NamedTuple):
    """The ink about a pixel.

    Fields
    ------
    x_mm, y_mm : (2,) rising, of the lines; one that carries no edge lies anywhere.
    ink : (9,) 1 for each inked cell between them, the lowest row first.
    """

    x_mm: Float[ArrayLike, "2"]
    y_mm: Float[ArrayLike, "2"]
    ink: Float[ArrayLike, "9"]


class PixelView(NamedTuple):
    """A pixel on the sheet, from which edges can be looked at."""

    sheet_from_camera: Float[ArrayLike, "3 3"]
    ray: Ray
    point: SheetPoint

    def circle(self, circle: Circle, radius_mm: Scalar) -> Edge:
        """The edge of given radius about a circle's centre."""
        return circular_edge(
            self.sheet_from_camera, self.ray, self.point, circle.centre_mm, radius_mm
        )


def nearest_ink(
    view: PixelView, figure: Circle | Squares, cross: Cross, drawing: InkDrawing, near_line: bool
) -> InkShare:
    """Ink of what is nearest to a pixel."""
    if isinstance(figure, Squares):
        return partial(ink_of_squares, view.point, figure)
    if near_line:
        return ink_of_sheet(view, figure, cross, drawing)
    return ink_of_circle(view, figure, drawing)


def ink_of_circle(view: PixelView, circle: Circle, drawing: InkDrawing) -> InkShare:
    """Ink of a disc or ring; a hole lies wholly inside its disc, so shares subtract."""
    outer = view.circle(circle, circle.radius_mm)
    hole, has_hole = _hole(view, circle, drawing)

    def share(dx: Scalar, dy: Scalar, spread: Scalar, kernel: Kernel) -> Scalar:
        ink = circle.present * coverage(outer, _shift(outer, dx, dy) - spread, kernel).share
        if hole is None:
            return ink
        return ink - has_hole * coverage(hole, _shift(hole, dx, dy) + spread, kernel).share

    return share


def ink_of_sheet(view: PixelView, circle: Circle, cross: Cross, drawing: InkDrawing) -> InkShare:
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

    def share(dx: Scalar, dy: Scalar, spread: Scalar, kernel: Kernel) -> Scalar:
        def cover(edge: Edge, grown: Scalar) -> EdgeCoverage:
            return coverage(edge, _shift(edge, dx, dy) - grown, kernel)

        def band(sides: tuple[Edge, Edge], grown: Scalar) -> Band:
            return cover(sides[0], grown), cover(sides[1], grown)

        def lines_on_disc(disc: EdgeCoverage, first: Band, second: Band) -> Scalar:
            crossing = _crossing(first, second) * disc.share
            return circle.present * (
                _lies_in_band(first, disc) + _lies_in_band(second, disc) - crossing
            )

        band_x, band_y = band(sides_x, spread), band(sides_y, spread)
        lines = _lies_in_band(band_x, cover(end_x, spread)) + _lies_in_band(
            band_y, cover(end_y, spread)
        )
        circles, lines = rings(dx, dy, spread, kernel), lines - _crossing(band_x, band_y)
        if drawing.line_style == "stop":
            return circles + lines - lines_on_disc(cover(gap, -spread), band_x, band_y)
        disc = cover(outer, spread)
        black = lines - lines_on_disc(disc, band_x, band_y)
        if drawing.line_style == "white":
            # Ink spreads into a white line from both sides.
            band_x, band_y = band(sides_x, -spread), band(sides_y, -spread)
            black = black - lines_on_disc(disc, band_x, band_y)
        if hole is None:
            return circles + black
        return circles + black + has_hole * lines_on_disc(cover(hole, -spread), band_x, band_y)

    return share


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
    return _lies_in_band(first, second[0]) + _lies_in_band(first, second[1]) - _share(first)


def _lies_in_band(band: Band, other: EdgeCoverage) -> Scalar:
    return common(band[0], other) + common(band[1], other) - other.share


def _hole(view: PixelView, circle: Circle, drawing: InkDrawing) -> tuple[Edge | None, Scalar]:
    """The edge of a ring's hole and 1, or some edge and 0 for a full disc."""
    if not drawing.has_rings:
        return None, jnp.zeros_like(circle.present)
    is_ring = circle.inner_radius_mm > 0
    radius = jnp.where(is_ring, circle.inner_radius_mm, circle.radius_mm)
    has_hole = jnp.where(is_ring, circle.present, jnp.zeros_like(circle.present))
    return view.circle(circle, radius), has_hole


def ink_of_squares(
    point: SheetPoint,
    squares: Squares,
    dx: Scalar,
    dy: Scalar,
    spread_mm: Scalar,
    kernel: Kernel,
) -> Scalar:
    """The share of ink where the pixel's point is displaced by (dx, dy) and ink spreads."""
    one, zero = jnp.ones_like(dx), jnp.zeros_like(dx)
    left_of = [
        _spread_both_ways(straight_edge(point, one, zero, squares.x_mm[k]), dx, spread_mm, kernel)
        for k in range(2)
    ]
    below = [
        _spread_both_ways(straight_edge(point, zero, one, squares.y_mm[k]), dy, spread_mm, kernel)
        for k in range(2)
    ]
    ink = [[squares.ink[3 * row + column] for column in range(3)] for row in range(3)]
    # Far up and far right there is the last cell; steps along the last row and the last column.
    share = ink[2][2]
    for k in range(2):
        step_x, step_y = ink[2][k] - ink[2][k + 1], ink[k][2] - ink[k + 1][2]
        share = share + step_x * _grown(left_of[k], step_x).share
        share = share + step_y * _grown(below[k], step_y).share
    for i in range(2):
        for j in range(2):
            fields = (ink[j][i], ink[j][i + 1], ink[j + 1][i], ink[j + 1][i + 1])
            share = share + _crossing_of_squares(left_of[i], below[j], *fields)
    return share


def _spread_both_ways(
    edge: Edge, shift_mm: Scalar, spread_mm: Scalar, kernel: Kernel
) -> _SpreadSides:
    """What lies before an edge, with ink spread to behind it and with ink spread to before it."""
    return coverage(edge, shift_mm - spread_mm, kernel), coverage(
        edge, shift_mm + spread_mm, kernel
    )


def _grown(sides: _SpreadSides, ink_before: Scalar) -> EdgeCoverage:
    """What lies before an edge that has its ink before it (1) or behind it (-1)."""
    return EdgeCoverage(
        *(jnp.where(ink_before > 0, more, less) for more, less in zip(*sides, strict=True))
    )


def _crossing_of_squares(
    left_of: _SpreadSides,
    below: _SpreadSides,
    lower_left: Scalar,
    lower_right: Scalar,
    upper_left: Scalar,
    upper_right: Scalar,
) -> Scalar:
    """What a crossing of two lines adds to the steps above it and on its right.

    The edges of the line along Y, below and above, make a quadrant each; where only one of them is
    there, or both alike, the line along X has one way to spread.
    """
    lower, upper = lower_left - lower_right, upper_left - upper_right
    before, after = lower_left - upper_left, lower_right - upper_right
    is_checker = lower * upper < 0
    aside = before + after
    first = jnp.where(is_checker, jnp.ones_like(aside), aside)
    second = jnp.where(is_checker, -jnp.ones_like(aside), aside)
    under = common(_grown(left_of, lower), _grown(below, first))
    over = common(_grown(left_of, upper), _grown(below, second))
    return lower * under - upper * over
