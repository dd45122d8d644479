"""Tail probabilities and quantiles of the chi-square and the normal distribution.

The values are those of `scipy.stats` to the last bit. Its import takes as long as a match.
"""

from typing import Any

import numpy as np
import scipy

# Ratio of standard deviation to median absolute deviation of a Gaussian.
MAD_TO_SIGMA = 1.4826

_Real = np.ndarray | np.generic | float


def chi_square_tail(value: _Real, degrees: _Real) -> Any:
    """Probability that a chi-square variable with `degrees` degrees of freedom exceeds `value`."""
    return scipy.special.chdtrc(degrees, value)


def chi_square_limit(tail: _Real, degrees: _Real) -> Any:
    """Value that a chi-square variable exceeds with probability `tail`."""
    return scipy.special.chdtri(degrees, tail)


def chi_square_quantile(share: _Real, degrees: _Real) -> Any:
    """Value below which a chi-square variable is with probability `share`."""
    return 2 * scipy.special.gammaincinv(np.asarray(degrees) / 2, share)


def normal_limit(tail: _Real) -> Any:
    """Value that a standard normal variable exceeds with probability `tail`."""
    return -scipy.special.ndtri(tail)
