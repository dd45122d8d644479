"""Logarithms of tails, of events so seldom that their probability is no number any more.

They are those of `scipy.stats`, without its import, which takes as long as a match.
"""

import numpy as np
from jaxtyping import Float
from scipy.special import log_ndtr, stdtr


def log_normal_tail(value: Float[np.ndarray, "*n"]) -> np.ndarray:
    """Natural logarithm of the probability that a standard normal variable exceeds `value`."""
    return log_ndtr(-value)


def log_student_tail(value: Float[np.ndarray, "*n"], degrees: float) -> np.ndarray:
    """The same of Student's t of so many degrees of freedom, -708 at least."""
    return np.log(np.maximum(stdtr(degrees, -value), np.finfo(np.float64).tiny))
