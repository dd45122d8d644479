"""Shapes S of ellipses (x - c)^T S^-1 (x - c) = 1, many at once, in closed form."""

import numpy as np
from jaxtyping import Float


def inverse_square_root(shape: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n 2 2"]:
    """Symmetric S^(-1/2), which maps the ellipse to the unit circle."""
    a, b, c = shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1]
    root = np.sqrt(a * c - b * b)
    # By Cayley and Hamilton, S^(1/2) = (S + root I) / sqrt(trace + 2 root); its inverse has the
    # same denominator over its determinant.
    scale = 1.0 / (root * np.sqrt(a + c + 2.0 * root))
    return (np.stack([c + root, -b, -b, a + root], axis=1) * scale[:, None]).reshape(-1, 2, 2)


def smallest_axis(shape: Float[np.ndarray, "n 2 2"]) -> Float[np.ndarray, "n"]:
    """The smaller semi-axis."""
    a, b, c = shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1]
    smallest = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
    return np.sqrt(np.maximum(smallest, 1e-12))
