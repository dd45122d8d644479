"""Vector products and axes of arrays of vectors, in NumPy.

For a few rows, `np.cross` takes ten times as long.
"""

import numpy as np
from jaxtyping import Float


def cross_2d(a: Float[np.ndarray, "*n 2"], b: Float[np.ndarray, "*n 2"]) -> np.ndarray:
    """Signed area of the parallelogram of two vectors."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def cross_3d(a: Float[np.ndarray, "*n 3"], b: Float[np.ndarray, "*m 3"]) -> np.ndarray:
    """Vector product; leading axes are broadcast."""
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], axis=-1)


def axes_across(unit: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2 3"]:
    """Two unit vectors across a unit vector and each other."""
    least = np.eye(3)[np.argmin(np.abs(unit), axis=-1)]
    first = cross_3d(unit, least)
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross_3d(unit, first)], axis=-2)
