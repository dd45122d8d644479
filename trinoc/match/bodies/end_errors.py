"""Errors of the two ends of what bodies show."""

import numpy as np
from jaxtyping import Float


def add_error_of_ends(
    covariance: Float[np.ndarray, "n p p"], error: Float[np.ndarray, "n 2 d"]
) -> None:
    """Add an error along one way of each of two ends, which come first, each d numbers."""
    size = error.shape[2]
    for end in (0, 1):
        own = slice(size * end, size * (end + 1))
        covariance[:, own, own] += error[:, end, :, None] * error[:, end, None]
