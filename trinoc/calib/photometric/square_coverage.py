"""The share of a blurred pixel that is ink on a board of squares.

About a pixel at most two lines of each direction carry edges, so that the ink there is that of
three by three cells. As a function of the place it is a sum of steps at the lines and of quadrants
at their crossings.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.photometric.edges import Coverage, Edge, common, coverage, straight_edge
from trinoc.calib.photometric.kernels import Kernel, kernel_coverage
from trinoc.calib.photometric.sheet_point import SheetPoint
from trinoc.numerics import ArrayLike

Scalar = Float[ArrayLike, ""]
# What lies before a line of an edge whose ink has spread one way, and the other.
_Sides = tuple[Coverage, Coverage]


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


def ink_of_squares(
    point: SheetPoint,
    squares: Squares,
    dx: Scalar,
    dy: Scalar,
    spread_mm: Scalar,
    blur: Scalar | Kernel,
) -> Scalar:
    """The share of ink where the pixel's point is displaced by (dx, dy) and ink spreads."""
    one, zero = jnp.ones_like(dx), jnp.zeros_like(dx)
    left_of = [
        _sides(straight_edge(point, one, zero, squares.x_mm[k]), dx, spread_mm, blur)
        for k in range(2)
    ]
    below = [
        _sides(straight_edge(point, zero, one, squares.y_mm[k]), dy, spread_mm, blur)
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
            share = share + _crossing(left_of[i], below[j], *fields)
    return share


def _sides(edge: Edge, shift_mm: Scalar, spread_mm: Scalar, blur: Scalar | Kernel) -> _Sides:
    """What lies before an edge, with ink spread to behind it and with ink spread to before it."""

    def covered(shift: Scalar) -> Coverage:
        if isinstance(blur, Kernel):
            return kernel_coverage(edge, shift, blur)
        return coverage(edge, shift, blur)

    return covered(shift_mm - spread_mm), covered(shift_mm + spread_mm)


def _grown(sides: _Sides, ink_before: Scalar) -> Coverage:
    """What lies before an edge that has its ink before it (1) or behind it (-1)."""
    return Coverage(
        *(jnp.where(ink_before > 0, more, less) for more, less in zip(*sides, strict=True))
    )


def _crossing(
    left_of: _Sides,
    below: _Sides,
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
