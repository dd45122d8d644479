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
    """Loss of squared residuals that grows more slowly than they do."""

    @abstractmethod
    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss rho(s) of squared residuals s."""

    @abstractmethod
    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Weight rho'(s) of a squared residual in reweighted least squares."""

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Square root of `weight`, the factor of a residual and of its row of the Jacobian."""
        return self.weight(squared) ** 0.5


class GemanMcClure(AbstractRobustLoss):
    """rho(s) = s / (1 + s / c^2), with the limit c^2 for large residuals.

    c is the scale, in the unit of the residual; an infinite scale gives plain least squares.
    Accepts NumPy and JAX arrays and keeps their precision. Source: S. Geman and D. E. McClure,
    Bulletin of the International Statistical Institute 52(4), 1987.

    Attributes
    ----------
    ceiling : scalar or (n,)
        c^2, the loss of a wrong observation. An array describes several losses for `vmap`.
    """

    ceiling: ScalarLike | Float[ArrayLike, "*n"]

    @classmethod
    def from_scale(cls, scale: ScalarLike | Float[ArrayLike, "*n"]) -> "GemanMcClure":
        """Loss with c = `scale`."""
        return cls(scale**2)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss s / (1 + s / c^2)."""
        return squared / (1 + squared / self.ceiling)

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Weight 1 / (1 + s / c^2)^2."""
        return 1 / (1 + squared / self.ceiling) ** 2

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Root of the weight, 1 / (1 + s / c^2)."""
        return 1 / (1 + squared / self.ceiling)

    def widen(self, factor: ScalarLike) -> "GemanMcClure":
        """The same loss for residuals that are `factor` times larger."""
        return GemanMcClure(self.ceiling * factor**2)


class ScaleMixture(AbstractRobustLoss):
    """Negative log likelihood of a mixture of Gaussian errors of several scales.

    The loss is -2 log(p(s) / p(0)). `squared` is the Mahalanobis distance of an observation of
    `size` numbers. In a share `shares[k]` of all cases, its standard deviations are those stated
    times `scales[k]`. Accepts NumPy and JAX arrays.
    """

    shares: tuple[float, ...] = eqx.field(static=True)
    scales: tuple[float, ...] = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Loss -2 log(p(s) / p(0))."""
        none = np.zeros((), squared.dtype)
        return -2 * (self.log_density(squared) - self.log_density(none))

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Posterior mean of 1 / scale^2, for the squared residual."""
        _, terms = self._terms(squared)
        return terms @ np.array(self.scales) ** -2.0 / terms.sum(axis=-1)

    def log_density(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """log p(s), for residuals in standard deviations."""
        largest, terms = self._terms(squared)
        logarithm = array_namespace(squared).log(terms.sum(axis=-1))
        return largest + logarithm - 0.5 * self.size * math.log(2 * math.pi)

    def _terms(
        self, squared: Float[ArrayLike, "*n"]
    ) -> tuple[Float[ArrayLike, "*n"], Float[ArrayLike, "*n k"]]:
        """(logarithm of the largest term, all terms divided by it).

        The division avoids underflow.
        """
        # A scale with share 0 may be the likeliest one far out, where all others underflow.
        share, scale = np.maximum(self.shares, np.finfo(float).tiny), np.array(self.scales)
        exponent = np.log(share) - self.size * np.log(scale) - 0.5 * squared[..., None] / scale**2
        largest = exponent.max(axis=-1)
        return largest, array_namespace(squared).exp(exponent - largest[..., None])
