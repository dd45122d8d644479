"""Tails of the chi-square, the normal and Student's distribution.

They are those of `scipy.stats` to the last bit, without its import, which takes as long as a match.
"""

from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import chdtrc, chdtri, gammaincinv, log_ndtr, ndtri, stdtr

# Standard deviation over median absolute deviation, of a Gaussian.
MAD_TO_SIGMA = 1.4826

_Real = np.ndarray | np.generic | float


def chi_square_tail(value: _Real, degrees: _Real) -> Any:
    """Probability that a chi-square of so many degrees of freedom exceeds `value`."""
    return chdtrc(degrees, value)


def chi_square_limit(tail: _Real, degrees: _Real) -> Any:
    """What a chi-square exceeds with the probability `tail`."""
    return chdtri(degrees, tail)


def chi_square_quantile(share: _Real, degrees: _Real) -> Any:
    """What a chi-square stays below with the probability `share`."""
    return 2 * gammaincinv(np.asarray(degrees) / 2, share)


def normal_limit(tail: _Real) -> Any:
    """What a standard normal variable exceeds with the probability `tail`."""
    return -ndtri(tail)


def log_normal_tail(value: Float[np.ndarray, "*n"]) -> np.ndarray:
    """Natural logarithm of the probability that a standard normal variable exceeds `value`."""
    return log_ndtr(-value)


def log_student_tail(value: Float[np.ndarray, "*n"], degrees: float) -> np.ndarray:
    """The same of Student's t of so many degrees of freedom, -708 at least."""
    return np.log(np.maximum(stdtr(degrees, -value), np.finfo(np.float64).tiny))
