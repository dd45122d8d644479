"""The share of a blurred pixel that is ink: circles, rings, and the crossed lines, or squares.

The part of the model that is differentiated takes a small displacement of the pixel's point
on the sheet: the edges' directions and curvatures stay as they are, which changes a row of
the Jacobian by a percent and the answer not at all.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.edges import (
    Edge,
    EdgeCoverage,
    Kernel,
    circular_edge,
    common,
    coverage,
    straight_edge,
)
from trinoc.calib.photometric.sheet_places import Ray, SheetPoint
from trinoc.numerics.precision import ArrayLike

# Of one pixel or of many, along the last axis.
Scalar = Float[ArrayLike, "*n"]
# (displacement on the sheet X, Y in mm, ink spread in mm, kernel) -> share of ink.
InkShare = Callable[[Scalar, Scalar, Scalar, Kernel], Scalar]
_Edges = TypeVar("_Edges", Edge, EdgeCoverage)
# numerical: the order of a sheet's edges: both lines' sides, their ends, the disc, then the gap at
# which lines stop; last of all the hole of a ring.
_SIDES, _ENDS, _OUTER, _GAP = slice(4), slice(4, 6), 6, 7
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

    centre_mm: Float[ArrayLike, "2 *n"]
    radius_mm: Scalar
    inner_radius_mm: Scalar
    present: Scalar


class Cross(NamedTuple):
    """The crossed lines, in mm: half their width, their reach, and their gap at a circle."""

    half_width_mm: Float[ArrayLike, ""]
    half_length_mm: Float[ArrayLike, "2"]
    gap_mm: Float[ArrayLike, ""]


class Squares(NamedTuple):
    """The ink about a pixel.

    Fields
    ------
    x_mm, y_mm : (2,) rising, of the lines; one that carries no edge lies anywhere.
    ink : (9,) 1 for each inked cell between them, the lowest row first.
    """

    x_mm: Float[ArrayLike, "2 *n"]
    y_mm: Float[ArrayLike, "2 *n"]
    ink: Float[ArrayLike, "9 *n"]


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
    """Ink of the crossed lines and the nearest circle, by how lines and circles meet.

    What lies on both of two edges is added and taken away: an end of a line, the crossing of both
    lines, and what of them lies on a disc. All edges are looked at together.
    """
    hole, has_hole = _hole(view, circle, drawing)
    # Lines end at a gap about the circle, or at the circle.
    discs = [view.circle(circle, circle.radius_mm)]
    if drawing.line_style == "stop":
        discs.append(view.circle(circle, circle.radius_mm + cross.gap_mm))
    if hole is not None:
        discs.append(hole)
    lines = _edges_of_lines(view.point, cross)
    edges = jax.tree.map(
        lambda straight, *curved: jnp.concatenate([straight, jnp.stack(curved)]), lines, *discs
    )
    # With the spread of ink discs and lines grow, and gap and hole shrink.
    grows = [1.0] * 7 + [-1.0] * (len(discs) - 1)

    def share(dx: Scalar, dy: Scalar, spread: Scalar, kernel: Kernel) -> Scalar:
        def cover(edge: Edge, grows: Scalar) -> EdgeCoverage:
            return coverage(edge, _shift(edge, dx, dy) - grows * spread, kernel)

        signs = jnp.asarray(grows, spread.dtype)
        covered = jax.vmap(cover)(edges, signs)
        sides, ends = _by_line(covered), _take(covered, _ENDS)
        outer, last = _take(covered, _OUTER), _take(covered, -1)
        crossing = _crossing(sides)
        short = jnp.sum(jax.vmap(jax.vmap(common, (0, None)))(sides, ends), axis=1)
        black = jnp.sum(short - ends.share, axis=0) - crossing
        circles = circle.present * outer.share
        if hole is not None:
            circles = circles - has_hole * last.share
        if drawing.line_style == "stop":
            limit = _take(covered, _GAP)
            return circles + black - circle.present * _lines_on_disc(sides, crossing, limit)
        black = black - circle.present * _lines_on_disc(sides, crossing, outer)
        if drawing.line_style == "white":
            # Ink spreads into a white line from both sides.
            sides = _by_line(jax.vmap(cover)(_take(edges, _SIDES), -signs[_SIDES]))
            crossing = _crossing(sides)
            black = black - circle.present * _lines_on_disc(sides, crossing, outer)
        if hole is None:
            return circles + black
        return circles + black + has_hole * _lines_on_disc(sides, crossing, last)

    return share


def _edges_of_lines(point: SheetPoint, cross: Cross) -> Edge:
    """Both sides of the line along X, both of the line along Y, and the nearer end of each."""
    x, y = point.point_mm[0], point.point_mm[1]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    side_x, side_y = jnp.where(x < 0, -one, one), jnp.where(y < 0, -one, one)
    normal_x = jnp.stack([zero, zero, one, -one, side_x, zero])
    normal_y = jnp.stack([one, -one, zero, zero, zero, side_y])
    offset_mm = jnp.stack([*[cross.half_width_mm] * 4, *cross.half_length_mm])
    return jax.vmap(straight_edge, (None, 0, 0, 0))(point, normal_x, normal_y, offset_mm)


def _shift(edge: Edge, dx: Scalar, dy: Scalar) -> Scalar:
    return edge.normal_x * dx + edge.normal_y * dy


def _by_line(covered: EdgeCoverage) -> EdgeCoverage:
    """Two sides of two lines."""
    return jax.tree.map(lambda leaf: leaf[_SIDES].reshape(2, 2, *leaf.shape[1:]), covered)


def _take(edges: _Edges, which: int | slice) -> _Edges:
    return jax.tree.map(lambda leaf: leaf[which], edges)


def _crossing(sides: EdgeCoverage) -> Scalar:
    """What lies in both lines."""
    along_x, along_y = _take(sides, 0), _take(sides, 1)
    both = jax.vmap(jax.vmap(common, (0, None)), (None, 0))(along_x, along_y)
    # In this order, differences are of numbers that are hardly larger: rounding stays small.
    of_sides = jnp.sum(jnp.sum(both, axis=1) - along_y.share, axis=0)
    return of_sides - (jnp.sum(along_x.share, axis=0) - 1)


def _lines_on_disc(sides: EdgeCoverage, crossing: Scalar, disc: EdgeCoverage) -> Scalar:
    """What of the lines lies on a disc."""
    both = jnp.sum(jax.vmap(jax.vmap(common, (0, None)), (0, None))(sides, disc), axis=1)
    return jnp.sum(both - disc.share[None], axis=0) - crossing * disc.share


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
    normal_x, normal_y = jnp.stack([one, one, zero, zero]), jnp.stack([zero, zero, one, one])
    offset_mm = jnp.concatenate([squares.x_mm, squares.y_mm])
    edges = jax.vmap(straight_edge, (None, 0, 0, 0))(point, normal_x, normal_y, offset_mm)
    ways = jnp.stack([-spread_mm, spread_mm])

    def cover_both_ways(edge: Edge) -> EdgeCoverage:
        shift = _shift(edge, dx, dy)
        return jax.vmap(lambda way: coverage(edge, shift + way, kernel))(ways)

    covered = jax.vmap(cover_both_ways)(edges)
    ink = squares.ink.reshape(3, 3, *dx.shape)
    # Far up and far right there is the last cell; steps along the last row and the last column.
    steps = jnp.concatenate([ink[2, :2] - ink[2, 1:], ink[:2, 2] - ink[1:, 2]])
    share = ink[2, 2] + jnp.sum(steps * jax.vmap(_grown)(covered, steps).share, axis=0)
    of_row = jax.vmap(_crossing_of_squares, (0, None, 0, 0, 0, 0))
    crossings = jax.vmap(of_row, (None, 0, 0, 0, 0, 0))(
        _take(covered, slice(2)),
        _take(covered, slice(2, 4)),
        *(ink[row : row + 2, column : column + 2] for row in range(2) for column in range(2)),
    )
    return share + jnp.sum(crossings, axis=(0, 1))


def _grown(sides: EdgeCoverage, ink_before: Scalar) -> EdgeCoverage:
    """What lies before an edge that has its ink before it (1) or behind it (-1), ink having spread
    to behind it (the first of `sides`) and to before it."""
    return jax.tree.map(lambda leaf: jnp.where(ink_before > 0, leaf[0], leaf[1]), sides)


def _crossing_of_squares(
    left_of: EdgeCoverage,
    below: EdgeCoverage,
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
