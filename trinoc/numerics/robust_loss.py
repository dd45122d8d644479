"""Robust losses: the influence of a wrong observation is bounded.

A residual r, in sigmas or in another unit, enters by its square s = r^2. A loss rho(s) is near s
for a right observation and grows less, or not at all, for a wrong one. A sum of rho is minimised by
iteratively reweighted least squares: the weights are rho'(s) at the current residuals. Source: P.
J. Huber, Robust Statistics, 1981, section 7.8.
"""

import math
from abc import abstractmethod

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace


class AbstractRobustLoss(eqx.Module):
    """Loss function that increases more slowly than the squared residual."""

    @abstractmethod
    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss rho(s) of squared residuals s, elementwise."""

    @abstractmethod
    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Weight rho'(s) of squared residuals s in reweighted least squares, elementwise."""

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Square root of the weight, the factor of a residual and of its row of the Jacobian."""
        return self.weight(squared) ** 0.5


class GemanMcClure(AbstractRobustLoss):
    """Robust loss rho(s) = s / (1 + s / c^2), which approaches c^2 for large residuals.

    c is the scale, in the unit of the residual. An infinite scale gives ordinary least squares.
    NumPy and JAX arrays are accepted and keep their precision.

    Attributes
    ----------
    ceiling : scalar or (n,)
        c^2, the loss of a very large residual. An array describes several losses for `vmap`.

    References
    ----------
    S. Geman and D. E. McClure, Bulletin of the International Statistical Institute 52(4), 1987.
    """

    ceiling: ScalarLike | Float[ArrayLike, "*n"]

    @classmethod
    def from_scale(cls, scale: ScalarLike | Float[ArrayLike, "*n"]) -> "GemanMcClure":
        """Loss with the scale c = `scale`."""
        return cls(scale**2)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss s / (1 + s / c^2) of squared residuals s."""
        return squared / (1 + squared / self.ceiling)

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Weight 1 / (1 + s / c^2)^2 of squared residuals s."""
        return 1 / (1 + squared / self.ceiling) ** 2

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Square root of the weight, 1 / (1 + s / c^2), of squared residuals s."""
        return 1 / (1 + squared / self.ceiling)

    def widen(self, factor: ScalarLike) -> "GemanMcClure":
        """Copy with a scale c that is `factor` times larger."""
        return GemanMcClure(self.ceiling * factor**2)


class ScaleMixture(AbstractRobustLoss):
    """Robust loss of errors from a mixture of Gaussian distributions with several scales.

    The loss of an observation is -2 log(p(s) / p(0)). Here s is its squared Mahalanobis distance
    and p the density of the mixture. NumPy and JAX arrays are accepted.

    Attributes
    ----------
    shares : tuple of float
        Weight of each component of the mixture; their sum is 1.
    scales : tuple of float
        Factor by which the standard deviations of each component exceed the stated ones.
    size : int
        Number of values in one observation.
    """

    shares: tuple[float, ...] = eqx.field(static=True)
    scales: tuple[float, ...] = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss -2 log(p(s) / p(0)) of squared residuals s."""
        none = np.zeros((), squared.dtype)
        return -2 * (self.log_density(squared) - self.log_density(none))

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Weight of squared residuals: posterior mean of 1 / scale^2."""
        _, terms = self._terms(squared)
        return terms @ np.array(self.scales) ** -2.0 / terms.sum(axis=-1)

    def log_density(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Log density log p(s) of residuals in standard deviations, from their squares s."""
        largest, terms = self._terms(squared)
        logarithm = array_namespace(squared).log(terms.sum(axis=-1))
        return largest + logarithm - 0.5 * self.size * math.log(2 * math.pi)

    def _terms(
        self, squared: Float[ArrayLike, "*n"]
    ) -> tuple[Float[ArrayLike, "*n"], Float[ArrayLike, "*n k"]]:
        """Terms of the mixture density, divided by the largest term to avoid underflow.

        Returns
        -------
        Logarithm of the largest term, and all divided terms (n, k).
        """
        # A scale with share 0 may be the likeliest one far out, where all others underflow.
        share, scale = np.maximum(self.shares, np.finfo(float).tiny), np.array(self.scales)
        exponent = np.log(share) - self.size * np.log(scale) - 0.5 * squared[..., None] / scale**2
        largest = exponent.max(axis=-1)
        return largest, array_namespace(squared).exp(exponent - largest[..., None])
