"""Which parameters the observations determine, and the covariance of those."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# A direction whose standard deviation exceeds this (rad, or share of the distance) has left
# the range in which a linear error means anything: it counts as free.
LARGEST_SIGMA = 0.1
# Share of a free direction in a parameter above which the parameter is not determined.
_FREE_SHARE = 1e-6


class Observability(NamedTuple):
    """What a Jacobian says about the parameters it belongs to.

    Fields
    ------
    rank : number of directions of the chart that the observations determine.
    covariance : (k, k) of the named parameters; NaN in the rows and columns of those that
        a free direction touches or that are beyond a linear error.
    gauge : indices of those parameters.
    """

    rank: int
    covariance: Float[np.ndarray, "k k"]
    gauge: tuple[int, ...]


def observability(
    information: Float[np.ndarray, "p p"],
    parameters_by_chart: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Rank of an information matrix, and the covariance on the directions it determines.

    The chart's columns are scaled alike (rad, shares of the distance), so that eigenvalues
    are comparable: 1 / eigenvalue is the variance of a direction. Nothing is damped: a
    covariance off the determined directions is refused, not made up, and so is that of a
    parameter beyond its `largest_sigma`, such as the pan of a camera that looks straight down.
    """
    values, vectors = np.linalg.eigh(information)
    is_real = values > 1e-14 * values.max(initial=0.0)
    return _of_eigenvalues(values, vectors, is_real, parameters_by_chart, largest_sigma)


def observability_of_root(
    root: Float[np.ndarray, "p p"],
    parameters_by_chart: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """`observability` of the information root^T root, without forming it.

    Standard deviations may differ by twelve digits, where the information holds seven.
    """
    _, values, vectors = np.linalg.svd(root)
    is_real = values > 1e-12 * values[0]
    return _of_eigenvalues(values**2, vectors.T, is_real, parameters_by_chart, largest_sigma)


def _of_eigenvalues(
    values: Float[np.ndarray, "p"],
    vectors: Float[np.ndarray, "p p"],
    is_real: Bool[np.ndarray, "p"],
    parameters_by_chart: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Of the eigenvalues and eigenvectors of the information, those apart that rounding made."""
    determined = (values > LARGEST_SIGMA**-2) & is_real
    free = np.abs(parameters_by_chart @ vectors[:, ~determined])
    scale = np.linalg.norm(parameters_by_chart, axis=1, keepdims=True)
    touched = (free > _FREE_SHARE * np.maximum(scale, 1e-300)).any(axis=1)
    by_direction = parameters_by_chart @ vectors[:, determined]
    covariance = (by_direction / values[determined]) @ by_direction.T
    touched |= np.sqrt(np.diag(covariance)) > largest_sigma
    covariance[touched] = np.nan
    covariance[:, touched] = np.nan
    return Observability(
        int(determined.sum()), covariance, tuple(int(k) for k in np.flatnonzero(touched))
    )
