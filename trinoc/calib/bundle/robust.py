"""A loss that a wrong match cannot buy: Geman and McClure's, on squared Mahalanobis distances.

rho(s) = s / (1 + s / c^2) grows like s for a right fragment and never exceeds c^2 for a wrong
one. Source: S. Geman and D. E. McClure, Bulletin of the ISI 52(4), 1987.
"""

from jaxtyping import Float

from trinoc.numerics import ArrayLike, ScalarLike


def loss(squared: Float[ArrayLike, "*n"], scale: ScalarLike) -> Float[ArrayLike, "*n"]:
    """rho(s) for s the squared distance in units of sigma, c the scale in sigma."""
    return squared / (1 + squared / scale**2)


def weight(squared: Float[ArrayLike, "*n"], scale: ScalarLike) -> Float[ArrayLike, "*n"]:
    """rho'(s), the weight of iteratively reweighted least squares."""
    return 1 / (1 + squared / scale**2) ** 2
