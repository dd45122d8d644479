"""Vectors as tuples of scalars, for kernels, and vector products of NumPy arrays.

Under `vmap` a scalar becomes one long array, and arithmetic on such arrays fuses into one loop over
the items. A batch of 3-vectors and 2x2 matrices would become thousands of tiny products, tens of
times slower on a CPU. Scalars may also be arrays of many items from the start, with axes that
broadcast.
"""

import functools
import operator
from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike, array_namespace

Scalar = Float[ArrayLike, "..."]
Vector2 = tuple[Scalar, Scalar]
Vector3 = tuple[Scalar, Scalar, Scalar]
# xx, xy, xz, yy, yz, zz
Symmetric3 = tuple[Scalar, Scalar, Scalar, Scalar, Scalar, Scalar]


def vector3(array: Float[ArrayLike, "... 3"]) -> Vector3:
    """Components x, y, z of vectors in an array (..., 3)."""
    return array[..., 0], array[..., 1], array[..., 2]


def in_front(a: Vector3) -> Vector3:
    """Copy of a vector whose components have a new first axis of length 1, for broadcasting."""
    return a[0][None], a[1][None], a[2][None]


def nth3(a: Vector3, k: int) -> Vector3:
    """Item `k` along the first axis of each component."""
    return a[0][k], a[1][k], a[2][k]


def nth6(a: Symmetric3, k: int) -> Symmetric3:
    """Item `k` along the first axis of each entry of a symmetric matrix."""
    return a[0][k], a[1][k], a[2][k], a[3][k], a[4][k], a[5][k]


def total(terms: Iterable[Scalar]) -> Scalar:
    """Sum of scalars (at least one), or sum over the first axis of an array."""
    return functools.reduce(operator.add, terms)


def largest(terms: Iterable[Scalar]) -> Scalar:
    """Maximum of scalars (at least one), or maximum along the first axis of an array."""
    terms = list(terms)
    return functools.reduce(array_namespace(terms).maximum, terms)


def least(terms: Iterable[Scalar]) -> Scalar:
    """Minimum of scalars (at least one), or minimum along the first axis of an array."""
    terms = list(terms)
    return functools.reduce(array_namespace(terms).minimum, terms)


def log_sum_exp(terms: Sequence[Scalar]) -> Scalar:
    """Logarithm of the sum of the exponentials of terms. At least one term must be finite."""
    xp, maximum = array_namespace(terms), largest(terms)
    return maximum + xp.log(total(xp.exp(term - maximum) for term in terms))


def dot3(a: Vector3, b: Vector3) -> Scalar:
    """Scalar product a . b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross3(a: Vector3, b: Vector3) -> Vector3:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def add3(a: Vector3, b: Vector3, factor: Scalar | float = 1.0) -> Vector3:
    """Vector a + factor * b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


def scaled3(a: Vector3, factor: Scalar) -> Vector3:
    """Vector factor * a."""
    return a[0] * factor, a[1] * factor, a[2] * factor


def unit3(a: Vector3) -> Vector3:
    """Unit vector along a."""
    return scaled3(a, 1 / array_namespace(a).sqrt(dot3(a, a)))


def outer3(a: Vector3, b: Vector3, weights: tuple[Scalar, Scalar, Scalar]) -> Symmetric3:
    """Symmetric matrix w0 a a^T + w1 (a b^T + b a^T) + w2 b b^T."""
    w0, w1, w2 = weights
    entries = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    xx, xy, xz, yy, yz, zz = (
        w0 * a[i] * a[j] + w1 * (a[i] * b[j] + a[j] * b[i]) + w2 * b[i] * b[j] for i, j in entries
    )
    return xx, xy, xz, yy, yz, zz


def times_matrix(matrix: Float[ArrayLike, "... 3 3"], a: Vector3) -> Vector3:
    """Product of a matrix and a vector."""
    return (
        dot3(vector3(matrix[..., 0, :]), a),
        dot3(vector3(matrix[..., 1, :]), a),
        dot3(vector3(matrix[..., 2, :]), a),
    )


def interpolated_covariance(
    covariance: tuple[Scalar, Scalar, Scalar], s: Scalar, t: Scalar
) -> Scalar:
    """Covariance of two points, each interpolated linearly between point 0 and point 1.

    Parameters
    ----------
    covariance : (scalar, scalar, scalar)
        Variance of point 0, covariance of both points, variance of point 1.
    s, t : scalar
        Position of each interpolated point: 0 at point 0, 1 at point 1.
    """
    c00, c01, c11 = covariance
    return (1 - s) * (1 - t) * c00 + (s * (1 - t) + t * (1 - s)) * c01 + s * t * c11


def add_error_of_ends(
    covariance: Float[np.ndarray, "n p p"], error: Float[np.ndarray, "n 2 d"]
) -> None:
    """Add the covariance of an independent error to each of two ends, in place.

    The error of an end is a random multiple of one vector.

    Parameters
    ----------
    covariance : (n, p, p)
        Covariances whose first 2 d variables are the coordinates of the two ends.
    error : (n, 2, d)
        Vector of each end: direction of the error, with its standard deviation as length.
    """
    size = error.shape[2]
    for end in (0, 1):
        columns = slice(size * end, size * (end + 1))
        covariance[:, columns, columns] += error[:, end, :, None] * error[:, end, None]


def cross_2d(a: Float[np.ndarray, "*n 2"], b: Float[np.ndarray, "*n 2"]) -> np.ndarray:
    """Signed area of the parallelogram of two vectors, (...).

    Ten times faster than `np.cross` for few rows.
    """
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def cross_3d(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*m 3"]) -> np.ndarray:
    """Vector product a x b; leading axes broadcast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def complete_axes(unit: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2 3"]:
    """Two unit vectors perpendicular to a given unit vector and to each other, (..., 2, 3)."""
    smallest_axis = np.eye(3)[np.argmin(np.abs(unit), axis=-1)]
    first = cross_3d(unit, smallest_axis)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross_3d(unit, first)], axis=-2)
