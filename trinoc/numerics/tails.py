"""Tails of the chi-square and the normal distribution.

They are those of `scipy.stats` to the last bit, without its import, which takes as long as a match.
"""

from typing import Any

import numpy as np
from scipy.special import chdtrc, chdtri, gammaincinv, ndtri

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
