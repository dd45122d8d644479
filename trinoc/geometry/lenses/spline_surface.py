"""A surface over the plane by uniform cubic B-splines: smooth to its second derivative.

Source: C. de Boor, "A Practical Guide to Splines", chapter IX (2001).
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.numerics import ArrayLike

# A cell is under the basis functions of so many control points along each side.
ORDER = 4


def surface(
    control: Float[ArrayLike, "rows columns"], place: Float[ArrayLike, "2"]
) -> Float[ArrayLike, ""]:
    """Height of the surface at a place, which counts cells from the grid's first corner.

    place : (along columns, along rows), from 0 to columns - 3 and rows - 3; beyond, the height is
        that of the nearest place of the grid.
    """
    rows, columns = control.shape
    column, across = _cell(place[0], columns)
    row, along = _cell(place[1], rows)
    near = jax.lax.dynamic_slice(jnp.asarray(control), (row, column), (ORDER, ORDER))
    return _weights(along) @ near @ _weights(across)


def _cell(
    place: Float[ArrayLike, ""], count: int
) -> tuple[Float[ArrayLike, ""], Float[ArrayLike, ""]]:
    """The cell of a place, and where in it, from 0 to 1."""
    cells = count - ORDER + 1
    inside = jnp.clip(place, 0.0, float(cells))
    cell = jnp.clip(jnp.floor(jax.lax.stop_gradient(inside)), 0.0, cells - 1.0)
    return cell.astype(jnp.int32), inside - cell


def _weights(t: Float[ArrayLike, ""]) -> Float[ArrayLike, "4"]:
    """The four basis functions over a cell; they sum to one."""
    s = 1.0 - t
    return (
        jnp.stack([s**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * s**2 + 3.0 * s**3, t**3]) / 6.0
    )


def smoothness(rows: int, columns: int, reach: float) -> Float[np.ndarray, "n n"]:
    """Inverse covariance of the control points of a smooth random surface of variance 1.

    reach : cells over which its heights go together. The points stand row by row. Heights have
    the covariance of Matern, of smoothness 1, and variance 1 on average over the grid. Source:
    F. Lindgren, H. Rue and J. Lindstrom, "An explicit link between Gaussian fields and Gaussian
    Markov random fields", J. R. Statist. Soc. B 73(4), 2011.
    """
    bend = np.kron(_bend(rows), np.eye(columns)) + np.kron(np.eye(rows), _bend(columns))
    root = 8.0 / reach**2 * np.eye(rows * columns) + bend
    information = root @ root
    heights = np.kron(_heights(rows), _heights(columns))
    variance = np.einsum("hi,ij,hj->h", heights, np.linalg.inv(information), heights)
    return float(variance.mean()) * information


def _bend(count: int) -> Float[np.ndarray, "n n"]:
    """Minus the second difference along a row of points, which ends without a slope."""
    step = np.diff(np.eye(count), axis=0)
    return step.T @ step


def _heights(count: int) -> Float[np.ndarray, "h n"]:
    """Heights at the cells' corners by the control points of one side."""
    return sum(
        weight * np.eye(count - ORDER + 2, count, k=k)
        for k, weight in enumerate((1 / 6, 2 / 3, 1 / 6))
    )
