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
    """Rank and covariance of the parameters that an information matrix determines.

    Attributes
    ----------
    rank : int
        Number of directions of the parametrisation that the observations determine.
    covariance : (k, k)
        Covariance of the named parameters. NaN in rows and columns of parameters that depend on a
        free direction, or whose sigma is too large for a linear error.
    gauge : tuple of int
        Indices of these undetermined parameters.
    """

    rank: int
    covariance: Float[np.ndarray, "k k"]
    gauge: tuple[int, ...]


def observability(
    information: Float[np.ndarray, "p p"],
    parameter_jacobian: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """Rank of an information matrix, and the covariance on the directions that it determines.

    Parameters
    ----------
    information : (p, p)
        Information of the local coordinates, which are scaled alike (rad, shares of the distance).
        So 1 / eigenvalue is the variance of a direction, and eigenvalues are comparable.
    parameter_jacobian : (k, p)
        Derivative of the named parameters by the local coordinates.
    largest_sigma : (k,)
        Largest sigma of each parameter for which a linear error is valid.

    Notes
    -----
    No damping: the covariance of an undetermined parameter is NaN, not a made-up number. An example
    is the pan of a camera that looks straight down.
    """
    values, vectors = np.linalg.eigh(information)
    is_real = values > 1e-14 * values.max(initial=0.0)
    return _of_eigenvalues(values, vectors, is_real, parameter_jacobian, largest_sigma)


def observability_of_root(
    root: Float[np.ndarray, "p p"],
    parameter_jacobian: Float[np.ndarray, "k p"],
    largest_sigma: Float[np.ndarray, "k"],
) -> Observability:
    """`observability` of the information root^T root, without forming the product.

    It stays accurate for standard deviations whose ratio is up to 1e12; the information matrix
    itself only up to 1e7.
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
    """Observability from the eigenvalues and eigenvectors of the information.

    `is_real` is False for eigenvalues that are rounding errors.
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
