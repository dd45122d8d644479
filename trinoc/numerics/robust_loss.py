"""Losses that a wrong observation cannot buy.

A residual r, in sigmas or in whatever unit its scale has, enters by its square s = r^2. A loss
rho(s) is near s for a right observation and levels out for a wrong one. Minimising a sum of rho
is least squares with the weights rho'(s) taken at the present residuals (iteratively reweighted
least squares). Source: P. J. Huber, Robust Statistics, 1981, section 7.8.
"""

from abc import abstractmethod

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.arrays import ArrayLike, ScalarLike


class AbstractRobustLoss(eqx.Module):
    """A bounded loss on squared residuals."""

    # What a wrong observation costs: rho never exceeds it. Squared residual's unit.
    ceiling: eqx.AbstractVar[ScalarLike | Float[ArrayLike, "*n"]]

    @abstractmethod
    def rho(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """The loss of squared residuals."""

    @abstractmethod
    def weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """rho'(s), the weight of a squared residual in reweighted least squares."""

    @abstractmethod
    def root_weight(self, squared: Float[ArrayLike, "*n"]) -> Float[ArrayLike, "*n"]:
        """Square root of `weight`: what a residual and its row of the Jacobian are scaled by."""

    @abstractmethod
    def bounded(
        self, residual: Float[ArrayLike, "*n d"], squared: Float[ArrayLike, "*n 1"]
    ) -> Float[ArrayLike, "*n d"]:
        """The residual scaled so that rho of its `squared` length becomes its squared length.

        Plain least squares over bounded residuals minimises the sum of rho.
        """

    @abstractmethod
    def widened(self, factor: ScalarLike) -> "AbstractRobustLoss":
        """The same loss for residuals `factor` times as large."""


class GemanMcClure(AbstractRobustLoss):
    """rho(s) = s / (1 + s / c^2), which levels out at c^2.

    c is the scale, in the unit of the residual; an infinite one is plain least squares. Works on
    NumPy and on JAX arrays alike, in their own precision. Source: S. Geman and D. E. McClure,
    Bulletin of the International Statistical Institute 52(4), 1987.

    Fields
    ------
    ceiling : c^2; of several losses at once, along their axes, for `vmap`.
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

    def bounded(
        self, residual: Float[ArrayLike, "*n d"], squared: Float[ArrayLike, "*n 1"]
    ) -> Float[ArrayLike, "*n d"]:
        """r / sqrt(1 + s / c^2)."""
        return residual / jnp.sqrt(1 + squared / self.ceiling)

    def widened(self, factor: ScalarLike) -> "GemanMcClure":
        """The loss of scale `factor` c."""
        return GemanMcClure(self.ceiling * factor**2)
