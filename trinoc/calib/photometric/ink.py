"""Share of ink in a blurred pixel: circles, rings, crossed lines, or squares.

The differentiable part of the model takes a small displacement of the pixel's point on the sheet.
Directions and curvatures of the edges stay constant. This changes the Jacobian by a percent and the
result not at all.
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
    coverage,
    coverage_of_both,
    straight_edge,
)
from trinoc.calib.photometric.sheet_geometry import Ray, SheetPoint
from trinoc.numerics.precision import ArrayLike

# A number for one pixel, or for many along the last axis.
Scalar = Float[ArrayLike, "*n"]
# (displacement on the sheet X, Y in mm, ink spread in mm, kernel) -> share of ink.
InkShare = Callable[[Scalar, Scalar, Scalar, Kernel], Scalar]
_Edges = TypeVar("_Edges", Edge, EdgeCoverage)
# numerical: order of the edges: sides of both lines, their ends, the disc, the gap at which lines
# stop, and last the hole of a ring.
_SIDES, _ENDS, _OUTER, _GAP = slice(4), slice(4, 6), 6, 7
# Value of `InkDrawing.line_style` for boards of squares, which have no lines.
SQUARES = "squares"


class InkDrawing(NamedTuple):
    """Properties of the sheet that select the model; constants of a compiled program.

    Attributes
    ----------
    line_style : line style of the pattern; `SQUARES` for a board of squares.
    has_rings : True if any circle is a ring.
    """

    line_style: str
    has_rings: bool


class Circle(NamedTuple):
    """Circle nearest to each pixel.

    Attributes
    ----------
    centre_mm : (2,) centre on the sheet.
    radius_mm : outer radius of the ink.
    inner_radius_mm : inner radius of the ink of a ring; 0 for a disc.
    present : 1, or 0 for a pixel that is not near a circle.
    """

    centre_mm: Float[ArrayLike, "2 *n"]
    radius_mm: Scalar
    inner_radius_mm: Scalar
    present: Scalar


class Cross(NamedTuple):
    """Crossed lines of a sheet.

    Attributes
    ----------
    half_width_mm : half the width of both lines.
    half_length_mm : half the lengths of the line along X and the line along Y.
    gap_mm : gap between a line and a circle on it, if lines stop at circles.
    """

    half_width_mm: Float[ArrayLike, ""]
    half_length_mm: Float[ArrayLike, "2"]
    gap_mm: Float[ArrayLike, ""]


class Squares(NamedTuple):
    """Ink around a pixel of a board of squares.

    It consists of 3 x 3 cells, separated by two lines along each axis.

    Attributes
    ----------
    x_mm, y_mm : (2,) increasing positions of the two lines along each axis; arbitrary for a line
        without an edge of ink.
    ink : (9,) 1 for each inked cell, else 0, row by row from the lowest Y.
    """

    x_mm: Float[ArrayLike, "2 *n"]
    y_mm: Float[ArrayLike, "2 *n"]
    ink: Float[ArrayLike, "9 *n"]


class PixelView(NamedTuple):
    """Pixel with its ray and its point on the sheet.

    Attributes
    ----------
    sheet_from_camera : homography from rays in the camera frame to the sheet.
    ray : ray of the pixel.
    point : point of the sheet under the pixel, with derivatives.
    """

    sheet_from_camera: Float[ArrayLike, "3 3"]
    ray: Ray
    point: SheetPoint

    def circle(self, circle: Circle, radius_mm: Scalar) -> Edge:
        """Edge of a circle with the centre of `circle` and the radius `radius_mm`."""
        return circular_edge(
            self.sheet_from_camera, self.ray, self.point, circle.centre_mm, radius_mm
        )


def nearest_ink(
    view: PixelView, local_ink: Circle | Squares, cross: Cross, drawing: InkDrawing, near_line: bool
) -> InkShare:
    """Return the function that computes the share of ink in each pixel.

    Parameters
    ----------
    view : pixels with their rays and points on the sheet.
    local_ink : circle nearest to each pixel, or the squares around each pixel.
    cross, drawing : crossed lines and properties of the sheet.
    near_line : True for pixels near a line.

    Returns
    -------
    Function of a displacement on the sheet in X and in Y, mm, the spread of ink, mm, and the
    kernel.
    """
    if isinstance(local_ink, Squares):
        return partial(ink_of_squares, view.point, local_ink)
    if near_line:
        return ink_of_sheet(view, local_ink, cross, drawing)
    return ink_of_circle(view, local_ink, drawing)


def ink_of_circle(view: PixelView, circle: Circle, drawing: InkDrawing) -> InkShare:
    """Function that computes the share of ink near a disc or a ring.

    `nearest_ink` describes its arguments. The share of a ring is that of its outer disc minus that
    of its hole.
    """
    outer = view.circle(circle, circle.radius_mm)
    hole, has_hole = _hole(view, circle, drawing)

    def share(dx: Scalar, dy: Scalar, spread: Scalar, kernel: Kernel) -> Scalar:
        ink = circle.present * coverage(outer, _shift(outer, dx, dy) - spread, kernel).share
        if hole is None:
            return ink
        return ink - has_hole * coverage(hole, _shift(hole, dx, dy) + spread, kernel).share

    return share


def ink_of_sheet(view: PixelView, circle: Circle, cross: Cross, drawing: InkDrawing) -> InkShare:
    """Function that computes the share of ink near the crossed lines and a circle.

    `nearest_ink` describes its arguments. The shares of lines and circle are combined by inclusion
    and exclusion: ends of lines, the crossing of both lines, and the part of the lines on a disc.
    All edges are evaluated in one vectorised call.
    """
    hole, has_hole = _hole(view, circle, drawing)
    # Lines end at the circle or at a gap around it.
    discs = [view.circle(circle, circle.radius_mm)]
    if drawing.line_style == "stop":
        discs.append(view.circle(circle, circle.radius_mm + cross.gap_mm))
    if hole is not None:
        discs.append(hole)
    lines = _edges_of_lines(view.point, cross)
    edges = jax.tree.map(
        lambda straight, *curved: jnp.concatenate([straight, jnp.stack(curved)]), lines, *discs
    )
    # Spread of ink enlarges discs and lines and reduces gaps and holes.
    grows = [1.0] * 7 + [-1.0] * (len(discs) - 1)

    def share(dx: Scalar, dy: Scalar, spread: Scalar, kernel: Kernel) -> Scalar:
        def cover(edge: Edge, grows: Scalar) -> EdgeCoverage:
            return coverage(edge, _shift(edge, dx, dy) - grows * spread, kernel)

        signs = jnp.asarray(grows, spread.dtype)
        covered = jax.vmap(cover)(edges, signs)
        sides, ends = _by_line(covered), _take(covered, _ENDS)
        outer, last = _take(covered, _OUTER), _take(covered, -1)
        crossing = _crossing(sides)
        short = jnp.sum(jax.vmap(jax.vmap(coverage_of_both, (0, None)))(sides, ends), axis=1)
        black = jnp.sum(short - ends.share, axis=0) - crossing
        circles = circle.present * outer.share
        if hole is not None:
            circles = circles - has_hole * last.share
        if drawing.line_style == "stop":
            limit = _take(covered, _GAP)
            return circles + black - circle.present * _lines_on_disc(sides, crossing, limit)
        black = black - circle.present * _lines_on_disc(sides, crossing, outer)
        if drawing.line_style == "white":
            # The ink of the circle spreads into a white line from both sides.
            sides = _by_line(jax.vmap(cover)(_take(edges, _SIDES), -signs[_SIDES]))
            crossing = _crossing(sides)
            black = black - circle.present * _lines_on_disc(sides, crossing, outer)
        if hole is None:
            return circles + black
        return circles + black + has_hole * _lines_on_disc(sides, crossing, last)

    return share


def _edges_of_lines(point: SheetPoint, cross: Cross) -> Edge:
    """Six edges: both sides of the line along X, both sides of the line along Y, and one end each.

    The ends are those nearest to the pixel.
    """
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
    """Coverages of the sides of the lines, with the first axes (crossed line, side of the line)."""
    return jax.tree.map(lambda leaf: leaf[_SIDES].reshape(2, 2, *leaf.shape[1:]), covered)


def _take(edges: _Edges, which: int | slice) -> _Edges:
    return jax.tree.map(lambda leaf: leaf[which], edges)


def _crossing(sides: EdgeCoverage) -> Scalar:
    """Share of the pixel inside both lines."""
    along_x, along_y = _take(sides, 0), _take(sides, 1)
    both = jax.vmap(jax.vmap(coverage_of_both, (0, None)), (None, 0))(along_x, along_y)
    # This order of the sums keeps rounding errors small.
    side_sum = jnp.sum(jnp.sum(both, axis=1) - along_y.share, axis=0)
    return side_sum - (jnp.sum(along_x.share, axis=0) - 1)


def _lines_on_disc(sides: EdgeCoverage, crossing: Scalar, disc: EdgeCoverage) -> Scalar:
    """Share of the pixel inside a line and inside a disc."""
    both = jnp.sum(jax.vmap(jax.vmap(coverage_of_both, (0, None)), (0, None))(sides, disc), axis=1)
    return jnp.sum(both - disc.share[None], axis=0) - crossing * disc.share


def _hole(view: PixelView, circle: Circle, drawing: InkDrawing) -> tuple[Edge | None, Scalar]:
    """Edge of a ring's hole and its weight 1; an arbitrary edge and the weight 0 for a disc.

    The edge is None if no circle of the sheet is a ring.
    """
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
    """Share of ink in a pixel of a board of squares.

    Parameters
    ----------
    point : point of the board under the pixel.
    squares : inked cells around the pixel.
    dx, dy : displacement of the point on the board, mm.
    spread_mm : spread of the ink beyond the edges of the drawing.
    kernel : blur kernel.
    """
    one, zero = jnp.ones_like(dx), jnp.zeros_like(dx)
    normal_x, normal_y = jnp.stack([one, one, zero, zero]), jnp.stack([zero, zero, one, one])
    offset_mm = jnp.concatenate([squares.x_mm, squares.y_mm])
    edges = jax.vmap(straight_edge, (None, 0, 0, 0))(point, normal_x, normal_y, offset_mm)
    spreads = jnp.stack([-spread_mm, spread_mm])

    def cover_with_both_spreads(edge: Edge) -> EdgeCoverage:
        shift = _shift(edge, dx, dy)
        return jax.vmap(lambda spread: coverage(edge, shift + spread, kernel))(spreads)

    covered = jax.vmap(cover_with_both_spreads)(edges)
    ink = squares.ink.reshape(3, 3, *dx.shape)
    # Start with the upper right cell; add the steps along the top row and the right column.
    steps = jnp.concatenate([ink[2, :2] - ink[2, 1:], ink[:2, 2] - ink[1:, 2]])
    share = ink[2, 2] + jnp.sum(steps * jax.vmap(_select_spread)(covered, steps).share, axis=0)
    crossings_of_row = jax.vmap(_crossing_of_squares, (0, None, 0, 0, 0, 0))
    crossings = jax.vmap(crossings_of_row, (None, 0, 0, 0, 0, 0))(
        _take(covered, slice(2)),
        _take(covered, slice(2, 4)),
        *(ink[row : row + 2, column : column + 2] for row in range(2) for column in range(2)),
    )
    return share + jnp.sum(crossings, axis=(0, 1))


def _select_spread(sides: EdgeCoverage, ink_before: Scalar) -> EdgeCoverage:
    """Select the one of two coverages that has the true direction of the spreading ink.

    sides : two coverages of the side of the edge with smaller coordinates: for ink that spreads
        toward larger coordinates, and for ink that spreads toward smaller coordinates.
    ink_before : positive if the ink is on the side with smaller coordinates, so that it spreads
        toward larger coordinates.
    """
    return jax.tree.map(lambda leaf: jnp.where(ink_before > 0, leaf[0], leaf[1]), sides)


def _crossing_of_squares(
    left_of: EdgeCoverage,
    below: EdgeCoverage,
    lower_left: Scalar,
    lower_right: Scalar,
    upper_left: Scalar,
    upper_right: Scalar,
) -> Scalar:
    """Correction of a pixel's share of ink for a crossing of two grid lines, along X and along Y.

    `ink_of_squares` first assumes that the edge above the crossing continues straight below it, and
    that the edge to the right continues to the left. The lower left cell may then be wrong. The
    correction is the missing ink of this cell times the share of the pixel in this quadrant.
    If the four cells alternate like a checkerboard, the ink is above the line along X on one side
    of the crossing and below it on the other. Spreading ink then moves the two halves of this edge
    in opposite directions.

    left_of : coverage of the side left of the line along Y, for ink that spreads to the right and
        for ink that spreads to the left.
    below : coverage of the side below the line along X, for ink that spreads up and for ink that
        spreads down.
    lower_left, lower_right, upper_left, upper_right : the four cells; 1 for an inked cell, else 0.
    """
    lower, upper = lower_left - lower_right, upper_left - upper_right
    before, after = lower_left - upper_left, lower_right - upper_right
    is_checker = lower * upper < 0
    total = before + after
    first = jnp.where(is_checker, jnp.ones_like(total), total)
    second = jnp.where(is_checker, -jnp.ones_like(total), total)
    under = coverage_of_both(_select_spread(left_of, lower), _select_spread(below, first))
    over = coverage_of_both(_select_spread(left_of, upper), _select_spread(below, second))
    return lower * under - upper * over
