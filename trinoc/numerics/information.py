"""Observability: the parameters that observations determine, and their covariance."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# A direction counts as free if its standard deviation exceeds this (rad, or share of the distance):
# a linear error is not valid there.
LARGEST_SIGMA = 0.1
# Share of a free direction in a parameter above which the parameter is not determined.
_FREE_SHARE = 1e-6


class Observability(NamedTuple):
    """Parameters that an information matrix determines, and their covariance.

    Attributes
    ----------
    rank : int
        Number of directions in the local coordinates that the observations determine.
    covariance : (k, k)
        Covariance of the named parameters. NaN in rows and columns of undetermined parameters:
        those that depend on an undetermined direction, or whose sigma is too large for linear
        error propagation.
    gauge : tuple of int
        Indices of the undetermined parameters.
    """

    rank: int
    covariance: Float[np.ndarray, "k k"]
    gauge: tuple[int, ...]


def observability(
    information: Float[np.ndarray, "p p"],
    parameter_jacobian: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Determine which parameters an information matrix determines, and their covariance.

    Parameters
    ----------
    information : (p, p)
        Information matrix of the local coordinates. Their units are rad and fractions of the
        distance, so that eigenvalues are comparable: 1 / eigenvalue is the variance along a
        direction.
    parameter_jacobian : (k, p)
        Derivative of the named parameters with respect to the local coordinates.
    largest_sigma : (k,)
        Largest sigma of each parameter for which linear error propagation is valid.

    Notes
    -----
    The information matrix is not damped. The covariance of an undetermined parameter is therefore
    NaN instead of a meaningless number. An example is the pan of a camera that looks straight down.
    """
    values, vectors = np.linalg.eigh(information)
    is_real = values > 1e-14 * values.max(initial=0.0)
    return _of_eigenvalues(values, vectors, is_real, parameter_jacobian, largest_sigma)


def observability_of_root(
    root: Float[np.ndarray, "p p"],
    parameter_jacobian: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Like `observability`, for the information matrix root^T root, whose product is not formed.

    The result is accurate for standard deviations whose ratio is up to 1e12. With the information
    matrix, it is accurate only up to 1e7.

    Parameters
    ----------
    root : (p, p)
        Square root of the information matrix.
    parameter_jacobian, largest_sigma :
        As in `observability`.
    """
    _, values, vectors = np.linalg.svd(root)
    is_real = values > 1e-12 * values[0]
    return _of_eigenvalues(values**2, vectors.T, is_real, parameter_jacobian, largest_sigma)


def _of_eigenvalues(
    values: Float[np.ndarray, "p"],
    vectors: Float[np.ndarray, "p p"],
    is_real: Bool[np.ndarray, "p"],
    parameter_jacobian: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Observability from the eigenvalues and eigenvectors of the information matrix.

    `is_real` is False for an eigenvalue that is a rounding error.
    """
    determined = (values > LARGEST_SIGMA**-2) & is_real
    free = np.abs(parameter_jacobian @ vectors[:, ~determined])
    scale = np.linalg.norm(parameter_jacobian, axis=1, keepdims=True)
    is_undetermined = (free > _FREE_SHARE * np.maximum(scale, 1e-300)).any(axis=1)
    by_direction = parameter_jacobian @ vectors[:, determined]
    covariance = (by_direction / values[determined]) @ by_direction.T
    is_undetermined |= np.sqrt(np.diag(covariance)) > largest_sigma
    covariance[is_undetermined] = np.nan
    covariance[:, is_undetermined] = np.nan
    return Observability(
        int(determined.sum()), covariance, tuple(int(k) for k in np.flatnonzero(is_undetermined))
    )
