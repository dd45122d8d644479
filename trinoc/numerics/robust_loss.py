"""Losses that a wrong observation cannot buy.

A residual r, in sigmas or in whatever unit its scale has, enters by its square s = r^2. A loss
rho(s) is near s for a right observation and grows less, or not at all, for a wrong one. Minimising
a sum of rho is least squares with the weights rho'(s) taken at the present residuals (iteratively
reweighted least squares). Source: P. J. Huber, Robust Statistics, 1981, section 7.8.
"""

import math
from abc import abstractmethod

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike, ScalarLike, array_namespace


class AbstractRobustLoss(eqx.Module):
    """A loss on squared residuals that grows more slowly than they do."""

    @abstractmethod
    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """The loss of squared residuals."""

    @abstractmethod
    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """rho'(s), the weight of a squared residual in reweighted least squares."""

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Square root of `weight`: what a residual and its row of the Jacobian are scaled by."""
        return self.weight(squared) ** 0.5


class GemanMcClure(AbstractRobustLoss):
    """rho(s) = s / (1 + s / c^2), which levels out at c^2.

    c is the scale, in the unit of the residual; an infinite one is plain least squares. Works on
    NumPy and on JAX arrays alike, in their own precision. Source: S. Geman and D. E. McClure,
    Bulletin of the International Statistical Institute 52(4), 1987.

    Fields
    ------
    ceiling : c^2, which a wrong observation costs; of several losses at once, along their axes,
        for `vmap`.
    """

    ceiling: ScalarLike | Float[ArrayLike, "*n"]

    @classmethod
    def from_scale(cls, scale: ScalarLike | Float[ArrayLike, "*n"]) -> "GemanMcClure":
        """The loss that levels out where residuals are about `scale`."""
        return cls(scale**2)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """s / (1 + s / c^2)."""
        return squared / (1 + squared / self.ceiling)

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """1 / (1 + s / c^2)^2."""
        return 1 / (1 + squared / self.ceiling) ** 2

    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """1 / (1 + s / c^2)."""
        return 1 / (1 + squared / self.ceiling)

    def widen(self, factor: ScalarLike) -> "GemanMcClure":
        """The same loss for residuals `factor` times as large."""
        return GemanMcClure(self.ceiling * factor**2)


class ScaleMixture(AbstractRobustLoss):
    """Minus twice the log likelihood, against no error at all, of errors of several sizes.

    An observation of `size` numbers errs by more than it states: its standard deviations are those
    stated times one of `scales`, in a share `shares` of all cases. `squared` is its Mahalanobis
    distance. Works on NumPy and on JAX arrays.
    """

    shares: tuple[float, ...] = eqx.field(static=True)
    scales: tuple[float, ...] = eqx.field(static=True)
    size: int = eqx.field(static=True)

    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """-2 log(p(s) / p(0))."""
        none = np.zeros((), squared.dtype)
        return -2 * (self.log_density(squared) - self.log_density(none))

    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """The mean of one over the squared scales, given the error."""
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
        """(logarithm of the largest term, all terms over it), which do not underflow together."""
        # A size without a share is the likeliest one far out, where all others underflow.
        share, scale = np.maximum(self.shares, np.finfo(float).tiny), np.array(self.scales)
        exponent = np.log(share) - self.size * np.log(scale) - 0.5 * squared[..., None] / scale**2
        largest = exponent.max(axis=-1)
        return largest, array_namespace(squared).exp(exponent - largest[..., None])
