"""Places of the board that lie elsewhere than the drawing says, found along with the rig.

A plate that is wavy by a tenth of a millimetre, or a print whose circles are some hundredths off,
shows every place aside in the same way in all shots. That is no noise: more shots do not average
it away, and lenses bend to follow it. Where the residuals show it, each place becomes an unknown of
three coordinates, whose spread over the board is estimated with them.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.equations import PlacesProblem
from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.outcome import shot_scatter
from trinoc.calib.problem.places import whitened_residuals
from trinoc.calib.problem.problem import Problem, with_head_free, with_priors
from trinoc.calib.problem.robust_fit import (
    LEAST_CHANGE,
    RobustFit,
    degrees_of_freedom,
    drop_wrong_places,
    errors_px,
    finish_fit,
    fit_places,
    use_all_places,
    with_sigma_factors,
)
from trinoc.calib.problem.shape_prior import ShapePrior, shape_prior
from trinoc.calib.problem.solver import gauss_newton_gain
from trinoc.calib.problem.variables import Parametrization, RigState
from trinoc.calib.problem.views import ViewTable
from trinoc.calib.problem.wrong_circles import drop_wrong_circles
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: more places would make the equations of all shots too large.
_MOST_PLACES = 300
# numerical: updates of the prior's variances.
_MOST_UPDATES = 12


def with_board_shape(fit: RobustFit) -> RobustFit:
    """The fit with every place of the board free, where the shots show that they lie elsewhere."""
    problem = fit.problem
    if len(problem.state.shape) or not _may_lie_elsewhere(problem):
        return fit
    spread_mm = problem.tuning.problem.first_spread * _residual_mm(problem)
    opened = with_free_places(problem, np.eye(3 * len(problem.target)) / spread_mm**2)
    if not _is_shown(opened):
        return fit
    prior = shape_prior(problem.target, spread_mm, problem.tuning)
    opened = with_priors(opened, shape_information=prior.information)
    by_pixels = any(view.shown is not None for view in opened.views)
    if not by_pixels:
        # Places that seemed to be located wrongly may only have lain elsewhere.
        opened = use_all_places(opened, fit.elsewhere)
    opened, _ = fit_places(opened)
    opened, prior = with_estimated_prior(opened, prior)
    if by_pixels:
        opened = drop_wrong_circles(opened)
    else:
        opened, _ = drop_wrong_places(opened)
    opened, _ = fit_places(opened)
    opened, _ = with_estimated_prior(opened, prior)
    shaped = finish_fit(opened, fit.elsewhere)
    return shaped if shaped.converged and _lenses_stay(fit.problem, shaped.problem) else fit


def _lenses_stay(before: Problem, after: Problem) -> bool:
    """Whether the focal lengths are those of the drawn board, but for a factor that a bent board
    explains: images that hardly determine them let a shape run away with them."""
    ratio = np.asarray(after.state.lenses.focal_length_px) / np.asarray(
        before.state.lenses.focal_length_px
    )
    largest = before.tuning.problem.largest_focal_change
    return bool(np.all(ratio < largest) and np.all(ratio > 1 / largest))


def _is_shown(opened: Problem) -> bool:
    """Whether free places would take more off the chi-square than chance."""
    gain, chi_square = (
        float(part) for part in _chi_square_gain(opened.state, opened.parametrization, opened.table)
    )
    unknowns = 3 * len(opened.target)
    left = degrees_of_freedom(opened) - unknowns
    if left <= unknowns:
        return False
    ratio = gain / unknowns / max((chi_square - gain) / left, 1e-300)
    return bool(
        ratio > 1.0 + opened.tuning.problem.refuted_sigmas * np.sqrt(2.0 / unknowns + 2.0 / left)
    )


def _may_lie_elsewhere(problem: Problem) -> bool:
    """Whether the board is not said to be exact, and small enough."""
    first = problem.slices.sheets.start
    return bool(np.any(problem.free[first:])) and len(problem.target) <= _MOST_PLACES


def _residual_mm(problem: Problem) -> float:
    """Residuals on the board, at the distance at which it was."""
    focal_px = float(np.mean(np.asarray(problem.state.lenses.focal_length_px)))
    errors = np.concatenate(
        [each[view.kept] for view, each in zip(problem.views, errors_px(problem), strict=True)]
    )
    return float(np.sqrt(np.mean(errors**2)) * problem.parametrization.unit_mm / focal_px)


def with_free_places(
    problem: Problem, shape_information: Float[np.ndarray, "m m"] | None = None
) -> Problem:
    """The problem with free places, where they are drawn.

    shape_information : of the prior, in 1/mm^2; a standard deviation of 1 mm unless given.
    """
    places = len(problem.target)
    if shape_information is None:
        shape_information = np.eye(3 * places)
    state = eqx.tree_at(lambda s: s.shape, problem.state, np.zeros((places, 3)))
    free = np.concatenate([np.asarray(problem.free), np.ones(3 * places)])
    known = with_priors(problem, shape_information=shape_information)
    return with_head_free(known._replace(state=state), free)


@kept_jit
def _chi_square_gain(state: RigState, parametrization: Parametrization, table: ViewTable) -> tuple:
    """What free places would take off the chi-square, to first order, and it."""
    plain = GemanMcClure.from_scale(jnp.full(len(table.shot), jnp.inf))
    equations = PlacesProblem(parametrization, table, plain).equations(state)
    gain = gauss_newton_gain(equations)
    return gain, jnp.sum(jnp.square(whitened_residuals(state, parametrization, table)))


def with_estimated_prior(problem: Problem, prior: ShapePrior) -> tuple[Problem, ShapePrior]:
    """The fit with the prior of the shape, and the sigmas, that its residuals show.

    Where shots disagree by a variance factor F, the noise by which the shape is judged is that of
    whole shots: the information of the prior is multiplied by F against that of the residuals.
    Otherwise what is common to the few shots by chance would be taken for the board's own shape.
    """
    factor = np.inf
    for _ in range(_MOST_UPDATES):
        scatter, covariance_mm2 = shape_covariance(problem)
        # A tighter prior leaves larger residuals, which must not tighten it again.
        factor = min(factor, scatter, problem.tuning.problem.largest_scatter)
        after = prior.update(np.asarray(problem.state.shape), covariance_mm2)
        spent = prior.count_determined(covariance_mm2)
        problem = with_sigma_factors(problem._replace(spent=max(spent, 0.0)))
        problem, converged = fit_places(
            with_priors(problem, shape_information=factor * after.information)
        )
        if not converged:
            break
        change = np.abs(np.log(after.variance / prior.variance)).max()
        prior = after
        if change < 2 * LEAST_CHANGE:
            break
    return problem, prior


def shape_covariance(problem: Problem) -> tuple[float, Float[np.ndarray, "m m"]]:
    """(variance factor of the shots, posterior covariance of the shape in mm^2 with it)."""
    count, unit_mm = 3 * len(problem.target), float(problem.parametrization.unit_mm)
    information = compute_information(problem)
    factor = shot_scatter(information).variance_factor
    covariance = np.nan_to_num(information.observability.covariance)[-count:, -count:]
    return factor, factor * unit_mm**2 * covariance
