"""A surface over the plane by uniform cubic B-splines: smooth to its second derivative.

Source: C. de Boor, "A Practical Guide to Splines", chapter IX (2001).
"""

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
    along, across = basis(place, rows, columns)
    return along @ control @ across


def basis(
    place: Float[ArrayLike, "2"], rows: int, columns: int
) -> tuple[Float[ArrayLike, "rows"], Float[ArrayLike, "columns"]]:
    """What each row, and each column, of control points counts at a place."""
    return _basis(place[1], rows), _basis(place[0], columns)


def _basis(place: Float[ArrayLike, ""], count: int) -> Float[ArrayLike, "n"]:
    """The basis function of every control point along one side; they sum to one.

    All of them, though four at most are not zero: a derivative by many control points is then one
    product of matrices, which takes less time than picking four out of each.
    """
    inside = jnp.clip(place, 0.0, float(count - ORDER + 1))
    away = jnp.abs(inside - (np.arange(count) - 1.0).astype(inside.dtype))
    near, far = jnp.maximum(1.0 - away, 0.0), jnp.maximum(2.0 - away, 0.0)
    return (far**3 - 4.0 * near**3) / 6.0


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
    near, middle = (np.eye(count - ORDER + 2, count, k=k) for k in (0, 1))
    return (near + 4.0 * middle + np.eye(count - ORDER + 2, count, k=2)) / 6.0
