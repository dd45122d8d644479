"""Least squares of many small problems at once, by Gauss and Newton, in NumPy.

A problem has a few parameters and some observations of one or a few numbers each. The caller says,
at a state, what the residuals are and how a step changes them; what a step is, is the caller's:
`retract` carries it out. All problems go the same number of steps, with their observations padded
to one number by a weight of 0, which may hold anything finite. A loss weighs an observation as a
whole.

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
# Of the largest eigenvalue of the information, its columns scaled alike: what is smaller is
# rounding, and the observations leave that direction free.
SMALLEST_SHARE = 1e-9


class Residuals(NamedTuple):
    """What h problems have of k observations of d numbers, predicted less observed, at a state.

    Fields
    ------
    residual : in standard deviations, with independent errors (see `whitening`).
    jacobian : its derivatives by the p parameters of a step.
    weight : of each observation, 0 for padding; 1 for all if absent.
    prior_residual, prior_precision : the state less what is known beforehand, in the parameters of
        a step, and the inverse of its variance; no prior if absent.
    """

    residual: Float[np.ndarray, "h k d"]
    jacobian: Float[np.ndarray, "h k d p"]
    weight: Float[np.ndarray, "h k"] | Bool[np.ndarray, "h k"] | None = None
    prior_residual: Float[np.ndarray, "h p"] | None = None
    prior_precision: Float[np.ndarray, "h p"] | None = None


class NormalEquations(NamedTuple):
    """information @ step = -gradient for each problem, and the misfit where they were taken.

    Fields
    ------
    information : J^T W J, the prior's included. gradient : J^T W r, the prior's included.
    squared, weight : of each observation, its squared length in standard deviations, and the
        weight that it had, by the loss and by itself.
    """

    information: Float[np.ndarray, "h p p"]
    gradient: Float[np.ndarray, "h p"]
    squared: Float[np.ndarray, "h k"]
    weight: Float[np.ndarray, "h k"]

    @property
    def chi_square(self) -> Float[np.ndarray, "h"]:
        """Sum of the weighted squares of the observations; the prior is none."""
        return (self.weight * self.squared).sum(axis=1)

    @property
    def finite(self) -> Bool[np.ndarray, "h"]:
        """Whether there are equations: a state may lie where the model has no value."""
        each = np.isfinite(self.information).all(axis=2) & np.isfinite(self.gradient)
        return np.asarray(each.all(axis=1))

    def step(self, largest: Float[np.ndarray, "*h p"] | float = np.inf) -> Float[np.ndarray, "h p"]:
        """The step of Gauss and Newton, shortened to the `largest` change of each parameter.

        Free directions are left alone, and so are problems without finite equations.
        """
        scaled, scale = self._scale_columns()
        # So little damping leaves known directions as they are, and makes the others regular.
        scaled = scaled + SMALLEST_SHARE * np.eye(scaled.shape[1])
        gradient = np.where(self.finite[:, None], self.gradient, 0.0) * scale
        step = -scale * np.linalg.solve(scaled, gradient[:, :, None])[:, :, 0]
        return step / np.maximum(np.abs(step / largest).max(axis=1), 1.0)[:, None]

    def rank(self) -> Int[np.ndarray, "h"]:
        """How many directions the observations and the prior determine."""
        return _are_determined(np.linalg.eigvalsh(self._scale_columns()[0])).sum(axis=1)

    def covariance(self) -> Float[np.ndarray, "h p p"]:
        """Inverse of the information; NaN where a direction is free."""
        scaled, scale = self._scale_columns()
        values, vectors = np.linalg.eigh(scaled)
        known = np.asarray(_are_determined(values).all(axis=1))[:, None, None]
        vectors = vectors * scale[:, :, None]
        inverse = (vectors / np.where(known, values[:, None], 1.0)) @ vectors.mT
        return np.where(known, inverse, np.nan)

    def _scale_columns(self) -> tuple[Float[np.ndarray, "h p p"], Float[np.ndarray, "h p"]]:
        """(information with a diagonal of 1, or 0 where nothing is known, what scales it)."""
        information = np.where(self.finite[:, None, None], self.information, 0.0)
        diagonal = np.einsum("hii->hi", information)
        scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        return information * scale[:, :, None] * scale[:, None], scale


def _are_determined(values: Float[np.ndarray, "h p"]) -> Bool[np.ndarray, "h p"]:
    """Of eigenvalues in ascending order, columns scaled alike, those that are not rounding."""
    return values > SMALLEST_SHARE * np.maximum(values[:, -1:], 1.0)


def normal_equations(at: Residuals, loss: AbstractRobustLoss | None = None) -> NormalEquations:
    """The equations of the next step; with a loss, of reweighted least squares."""
    count, observations, numbers, parameters = at.jacobian.shape
    shape = count, observations * numbers
    squared = np.einsum("hkd,hkd->hk", at.residual, at.residual)
    weight = np.ones_like(squared) if at.weight is None else at.weight
    if loss is not None:
        weight = weight * np.asarray(loss.weight(squared))
    rows = at.jacobian.reshape(*shape, parameters)
    # Weights of 1 are left out.
    plain = at.weight is None and loss is None
    weighted = rows if plain else (at.jacobian * weight[:, :, None, None]).reshape(rows.shape)
    weighted = weighted.mT
    information = (weighted @ rows).astype(float)
    gradient = (weighted @ at.residual.reshape(*shape, 1))[:, :, 0].astype(float)
    if at.prior_precision is not None and at.prior_residual is not None:
        diagonal = np.einsum("hii->hi", information)
        diagonal += at.prior_precision
        gradient += at.prior_precision * at.prior_residual
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
    """(the states after so many steps, the normal equations there)."""
    state = start
    equations = normal_equations(residuals(state), loss)
    for _ in range(steps):
        state = retract(state, equations.step(largest_step))
        equations = normal_equations(residuals(state), loss)
    return state, equations


def whitening(covariance: Float[np.ndarray, "*n d d"]) -> Float[np.ndarray, "*n d d"]:
    """W with W covariance W^T = 1: it brings errors to independent ones of one standard deviation.

    W is lower triangular; raises LinAlgError for a covariance that is not positive definite.
    """
    return np.linalg.inv(np.linalg.cholesky(covariance))


def misfit_factor(
    chi_square: Float[np.ndarray, "h"], degrees: Int[np.ndarray, "h"] | int
) -> Float[np.ndarray, "h"]:
    """What to multiply a covariance by where errors are larger than stated; never below 1."""
    return np.maximum(chi_square / np.maximum(degrees, 1), 1.0)
