"""Estimation of the displacements of single board points from the drawing, together with the rig.

On a wavy plate, or an inaccurate print, each point is displaced in the same way in all shots. More
shots do not average this out, and the lenses become wrong. If the residuals show displacements,
each board point gets three unknown coordinates with a prior, whose variances are also estimated.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.equations import PointsProblem
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.outcome import shot_scatter
from trinoc.calib.problem.problem import Problem, with_free_parameters, with_priors
from trinoc.calib.problem.reprojection import whitened_residuals
from trinoc.calib.problem.robust_fit import (
    LEAST_CHANGE,
    RobustFit,
    degrees_of_freedom,
    drop_wrong_points,
    errors_px,
    finish_fit,
    fit_points,
    use_all_points,
    with_sigma_factors,
)
from trinoc.calib.problem.shape_prior import ShapePrior, shape_prior
from trinoc.calib.problem.solver import gauss_newton_gain
from trinoc.calib.problem.variables import Parametrization, RigState
from trinoc.calib.problem.views import ObservationTable
from trinoc.calib.problem.wrong_circles import drop_wrong_circles
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: more board points would make the equations of all shots too large.
_MOST_POINTS = 300
# numerical: updates of the prior's variances.
_MOST_UPDATES = 12


def with_board_shape(fit: RobustFit) -> RobustFit:
    """Fit again with a free 3-D displacement of every board point, if the residuals require it.

    The given fit is returned unchanged if the displacements are not significant, if the new fit
    does not converge, or if its focal lengths change too much.
    """
    problem = fit.problem
    if len(problem.state.shape) or not _may_be_displaced(problem):
        return fit
    spread_mm = problem.tuning.problem.first_spread * _residual_mm(problem)
    freed = with_free_points(problem, np.eye(3 * len(problem.target)) / spread_mm**2)
    if not _is_significant(freed):
        return fit
    prior = shape_prior(problem.target, spread_mm, problem.tuning)
    freed = with_priors(freed, shape_information=prior.information)
    by_pixels = any(view.grey_level_points is not None for view in freed.views)
    if not by_pixels:
        # Apparent outliers may only have been displaced on the board.
        freed = use_all_points(freed, fit.rejected_images)
    freed, _ = fit_points(freed)
    freed, prior = with_estimated_prior(freed, prior)
    if by_pixels:
        freed = drop_wrong_circles(freed)
    else:
        freed, _ = drop_wrong_points(freed)
    freed, _ = fit_points(freed)
    freed, _ = with_estimated_prior(freed, prior)
    shaped = finish_fit(freed, fit.rejected_images)
    return shaped if shaped.converged and _lenses_stay(fit.problem, shaped.problem) else fit


def _lenses_stay(before: Problem, after: Problem) -> bool:
    """True if the focal lengths of two fits differ by less than a fixed ratio.

    If the images hardly determine the focal lengths, free displacements of the board points could
    change the focal lengths arbitrarily.
    """
    ratio = np.asarray(after.state.lenses.focal_length_px) / np.asarray(
        before.state.lenses.focal_length_px
    )
    largest = before.tuning.problem.largest_focal_change
    return bool(np.all(ratio < largest) and np.all(ratio > 1 / largest))


def _is_significant(freed: Problem) -> bool:
    """True if free displacements of the board points reduce chi-square by more than noise would (F
    ratio).

    freed : problem with free displacements, evaluated at zero displacement.
    """
    gain, chi_square = (
        float(part) for part in _chi_square_gain(freed.state, freed.parametrization, freed.table)
    )
    unknowns = 3 * len(freed.target)
    remaining_freedom = degrees_of_freedom(freed) - unknowns
    if remaining_freedom <= unknowns:
        return False
    ratio = gain / unknowns / max((chi_square - gain) / remaining_freedom, 1e-300)
    return bool(
        ratio
        > 1.0
        + freed.tuning.problem.refuted_sigmas * np.sqrt(2.0 / unknowns + 2.0 / remaining_freedom)
    )


def _may_be_displaced(problem: Problem) -> bool:
    """True if the board is not assumed exact and has at most `_MOST_POINTS` board points."""
    first = problem.slices.sheets.start
    return bool(np.any(problem.free[first:])) and len(problem.target) <= _MOST_POINTS


def _residual_mm(problem: Problem) -> float:
    """Root mean square residual, converted from px to mm at the distance of the board."""
    focal_px = float(np.mean(np.asarray(problem.state.lenses.focal_length_px)))
    errors = np.concatenate(
        [each[view.rows_used] for view, each in zip(problem.views, errors_px(problem), strict=True)]
    )
    return float(np.sqrt(np.mean(errors**2)) * problem.parametrization.unit_mm / focal_px)


def with_free_points(
    problem: Problem, shape_information: Float[np.ndarray, "m m"] | None = None
) -> Problem:
    """Problem in which each board point has a free 3-D displacement from the drawing, starting at
    0.

    shape_information : prior information (inverse covariance) of the displacements, 1/mm^2.
        Default: an independent standard deviation of 1 mm per coordinate.
    """
    points = len(problem.target)
    if shape_information is None:
        shape_information = np.eye(3 * points)
    state = eqx.tree_at(lambda s: s.shape, problem.state, np.zeros((points, 3)))
    free = np.concatenate([np.asarray(problem.free), np.ones(3 * points)])
    with_prior = with_priors(problem, shape_information=shape_information)
    return with_free_parameters(with_prior._replace(state=state), free)


@kept_jit
def _chi_square_gain(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> tuple:
    """Return the predicted reduction of chi-square by free board points, and the present
    chi-square.

    The reduction is computed to first order, without a new fit.
    """
    plain = GemanMcClure.from_scale(jnp.full(len(table.shot), jnp.inf))
    equations = PointsProblem(parametrization, table, plain).equations(state)
    gain = gauss_newton_gain(equations)
    return gain, jnp.sum(jnp.square(whitened_residuals(state, parametrization, table)))


def with_estimated_prior(problem: Problem, prior: ShapePrior) -> tuple[Problem, ShapePrior]:
    """Estimate the variances of the shape prior and the sigmas of the points, and fit with them.

    The estimates come from the residuals. Estimation and fit are repeated until the prior no longer
    changes. Returns the fitted problem and the prior.

    If all points of a shot have common errors, the variance between the shots is F times that
    expected from the point sigmas. The information of the shape prior is then multiplied by F.
    Otherwise errors that few shots share by chance would be mistaken for the shape of the board.
    """
    factor = np.inf
    for _ in range(_MOST_UPDATES):
        scatter, covariance_mm2 = shape_covariance(problem)
        # A tighter prior leaves larger residuals, which must not tighten it again.
        factor = min(factor, scatter, problem.tuning.problem.largest_scatter)
        updated_prior = prior.update(np.asarray(problem.state.shape), covariance_mm2)
        determined = prior.count_determined(covariance_mm2)
        problem = with_sigma_factors(problem._replace(shape_dof=max(determined, 0.0)))
        problem, converged = fit_points(
            with_priors(problem, shape_information=factor * updated_prior.information)
        )
        if not converged:
            break
        change = np.abs(np.log(updated_prior.variance / prior.variance)).max()
        prior = updated_prior
        if change < 2 * LEAST_CHANGE:
            break
    return problem, prior


def shape_covariance(problem: Problem) -> tuple[float, Float[np.ndarray, "m m"]]:
    """Variance factor F of the scatter between the shots, and posterior covariance of all board
    point displacements, mm^2.

    The covariance is multiplied by F. F is 1 if the point sigmas explain the scatter.
    """
    count, unit_mm = 3 * len(problem.target), float(problem.parametrization.unit_mm)
    information = compute_information(problem)
    factor = shot_scatter(information).variance_factor
    covariance = np.nan_to_num(information.observability.covariance)[-count:, -count:]
    return factor, factor * unit_mm**2 * covariance
