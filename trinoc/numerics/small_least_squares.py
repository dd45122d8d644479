"""Gauss-Newton for many small least-squares problems at once, in NumPy.

A problem has a few parameters and some observations of one or a few numbers each. The caller
provides residuals and Jacobian at a state, and applies a step to it (`retract`). All problems take
the same number of steps. Padded observations have weight 0 and any finite values. A loss weights an
observation as a whole.

Residuals are in standard deviations, so that the inverse of the information is the covariance.
Sources: Nocedal and Wright, "Numerical Optimization" (2006), section 10.3; Huber, "Robust
Statistics" (1981), section 7.8 (iteratively reweighted least squares).
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics.robust_loss import AbstractRobustLoss

_State = TypeVar("_State")
# Eigenvalues below this share of the largest one are rounding errors: their direction is free. The
# columns of the information are scaled alike.
SMALLEST_SHARE = 1e-9


class Residuals(NamedTuple):
    """Residuals (predicted minus observed) and Jacobian of h independent problems at their states.

    Attributes
    ----------
    residual : (h, k, d)
        Residuals of k observations of d values each, in standard deviations.
    jacobian : (h, k, d, p)
        Derivatives of the residuals with respect to the p parameters.
    weight : (h, k), optional
        Weight of each observation; 0 for padding.
    prior_residual, prior_precision : (h, p), optional
        Difference of each parameter from its prior mean, and inverse variance of the prior.
    """

    residual: Float[np.ndarray, "h k d"]
    jacobian: Float[np.ndarray, "h k d p"]
    weight: Float[np.ndarray, "h k"] | Bool[np.ndarray, "h k"] | None = None
    prior_residual: Float[np.ndarray, "h p"] | None = None
    prior_precision: Float[np.ndarray, "h p"] | None = None


class NormalEquations(NamedTuple):
    """Normal equations of h independent problems: information @ step = -gradient.

    Attributes
    ----------
    information : (h, p, p)
        J^T W J plus the information of the prior.
    gradient : (h, p)
        J^T W r plus the gradient of the prior.
    squared : (h, k)
        Squared length of the residual of each observation, in standard deviations.
    weight : (h, k)
        Weight of each observation multiplied by the weight of the robust loss.
    """

    information: Float[np.ndarray, "h p p"]
    gradient: Float[np.ndarray, "h p"]
    squared: Float[np.ndarray, "h k"]
    weight: Float[np.ndarray, "h k"]

    @property
    def chi_square(self) -> Float[np.ndarray, "h"]:
        """Chi-square of the observations of each problem, (h,), without the prior.

        It is the sum of weight times squared residual.
        """
        return (self.weight * self.squared).sum(axis=1)

    @property
    def finite(self) -> Bool[np.ndarray, "h"]:
        """Mask of the problems with finite equations, (h,).

        At some states, the model has no value.
        """
        is_finite = np.isfinite(self.information).all(axis=2) & np.isfinite(self.gradient)
        return np.asarray(is_finite.all(axis=1))

    def step(self, largest: Float[np.ndarray, "*h p"] | float = np.inf) -> Float[np.ndarray, "h p"]:
        """Gauss-Newton step of each problem, (h, p).

        The step is zero along undetermined directions, and in all directions for a problem whose
        equations are not finite.

        Parameters
        ----------
        largest : (h, p) or float
            Largest change of each parameter. A step that exceeds it is shortened.
        """
        scaled, scale = self._scale_columns()
        # This small damping does not change determined directions and regularises the others.
        scaled = scaled + SMALLEST_SHARE * np.eye(scaled.shape[1])
        gradient = np.where(self.finite[:, None], self.gradient, 0.0) * scale
        step = -scale * np.linalg.solve(scaled, gradient[:, :, None])[:, :, 0]
        return step / np.maximum(np.abs(step / largest).max(axis=1), 1.0)[:, None]

    def rank(self) -> Int[np.ndarray, "h"]:
        """Number of directions that observations and prior determine, for each problem, (h,)."""
        return _are_determined(np.linalg.eigvalsh(self._scale_columns()[0])).sum(axis=1)

    def covariance(self) -> Float[np.ndarray, "h p p"]:
        """Inverse of the information, (h, p, p); NaN for a problem that is not fully determined."""
        scaled, scale = self._scale_columns()
        values, vectors = np.linalg.eigh(scaled)
        is_determined = np.asarray(_are_determined(values).all(axis=1))[:, None, None]
        vectors = vectors * scale[:, :, None]
        inverse = (vectors / np.where(is_determined, values[:, None], 1.0)) @ vectors.mT
        return np.where(is_determined, inverse, np.nan)

    def _scale_columns(self) -> tuple[Float[np.ndarray, "h p p"], Float[np.ndarray, "h p"]]:
        """Information scaled to a unit diagonal, (h, p, p), and the scale factors, (h, p).

        The diagonal is 0 for a parameter without information.
        """
        information = np.where(self.finite[:, None, None], self.information, 0.0)
        diagonal = np.einsum("hii->hi", information)
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        return information * scale[:, :, None] * scale[:, None], scale


def _are_determined(values: Float[np.ndarray, "h p"]) -> Bool[np.ndarray, "h p"]:
    """Mask of the eigenvalues (ascending) that exceed rounding errors, (h, p)."""
    return values > SMALLEST_SHARE * np.maximum(values[:, -1:], 1.0)


def normal_equations(terms: Residuals, loss: AbstractRobustLoss | None = None) -> NormalEquations:
    """Build the normal equations from the residuals of h independent problems.

    Parameters
    ----------
    terms : Residuals
        Residuals and Jacobian.
    loss : AbstractRobustLoss, optional
        Robust loss. The equations are then those of iteratively reweighted least squares.
    """
    count, observations, numbers, parameters = terms.jacobian.shape
    shape = count, observations * numbers
    squared = np.einsum("hkd,hkd->hk", terms.residual, terms.residual)
    weight = np.ones_like(squared) if terms.weight is None else terms.weight
    if loss is not None:
        weight = weight * np.asarray(loss.weight(squared))
    rows = terms.jacobian.reshape(*shape, parameters)
    # Weights of 1 are left out.
    is_unweighted = terms.weight is None and loss is None
    weighted = (
        rows if is_unweighted else (terms.jacobian * weight[:, :, None, None]).reshape(rows.shape)
    )
    weighted = weighted.mT
    information = (weighted @ rows).astype(float)
    gradient = (weighted @ terms.residual.reshape(*shape, 1))[:, :, 0].astype(float)
    if terms.prior_precision is not None and terms.prior_residual is not None:
        diagonal = np.einsum("hii->hi", information)
        diagonal += terms.prior_precision
        gradient += terms.prior_precision * terms.prior_residual
    return NormalEquations(information, gradient, squared, weight)


def gauss_newton(
    residuals: Callable[[_State], Residuals],
    retract: Callable[[_State, Float[np.ndarray, "h p"]], _State],
    start: _State,
    *,
    steps: int,
    loss: AbstractRobustLoss | None = None,
    largest_step: Float[np.ndarray, "*h p"] | float = np.inf,
) -> tuple[_State, NormalEquations]:
    """Take Gauss-Newton steps in many independent problems at once.

    Parameters
    ----------
    residuals : callable
        Function that returns the residuals at the states.
    retract : callable
        Function of states and steps (h, p) that returns the states after the steps.
    start : states
        Initial states.
    steps : int
        Number of steps.
    loss : AbstractRobustLoss, optional
        Robust loss.
    largest_step : (h, p) or float
        Largest change of each parameter in one step.

    Returns
    -------
    States after the last step, and the normal equations at these states.
    """
    state = start
    equations = normal_equations(residuals(state), loss)
    for _ in range(steps):
        state = retract(state, equations.step(largest_step))
        equations = normal_equations(residuals(state), loss)
    return state, equations


def whitening(covariance: Float[np.ndarray, "*n d d"]) -> Float[np.ndarray, "*n d d"]:
    """Lower triangular matrix W (d, d) with W covariance W^T = identity.

    It transforms errors with this covariance to independent errors of variance 1.

    Raises
    ------
    LinAlgError
        If the covariance is not positive definite.
    """
    return np.linalg.inv(np.linalg.cholesky(covariance))


def misfit_factor(
    chi_square: Float[np.ndarray, "h"], degrees: Int[np.ndarray, "h"] | int
) -> Float[np.ndarray, "h"]:
    """Factor by which a covariance is multiplied if the errors are larger than stated, (h,).

    The factor is the reduced chi-square, but at least 1.

    Parameters
    ----------
    chi_square : (h,)
        Chi-square of each problem.
    degrees : (h,) or int
        Degrees of freedom.
    """
    return np.maximum(chi_square / np.maximum(degrees, 1), 1.0)
