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
from trinoc.calib.problem.places import whitened_residuals
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import (
    LEAST_CHANGE,
    MOST_ROUNDS,
    RobustFit,
    degrees_of_freedom,
    drop_wrong_places,
    errors_px,
    finish_fit,
    fit_places,
    use_all_places,
    with_sigma_factors,
)
from trinoc.calib.problem.solver import gauss_newton_gain
from trinoc.calib.problem.variables import Chart, RigState
from trinoc.calib.problem.views import ViewTable
from trinoc.calib.problem.wrong_circles import drop_wrong_circles
from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: more places would make the equations of all shots too large.
_MOST_PLACES = 300


def with_board_shape(fit: RobustFit) -> RobustFit:
    """The fit with every place of the board free, where the shots show that they lie elsewhere."""
    problem = fit.problem
    if len(problem.state.shape) or not _may_lie_elsewhere(problem):
        return fit
    spread_mm = np.full(3, TUNING.problem.first_spread * _residual_mm(problem))
    opened = _with_spread(with_free_places(problem), spread_mm)
    if not _is_shown(opened):
        return fit
    by_pixels = any(view.shown is not None for view in opened.views)
    if not by_pixels:
        # Places that seemed to be located wrongly may only have lain elsewhere.
        opened = use_all_places(opened, fit.elsewhere)
    opened, _ = fit_places(opened)
    opened = _with_own_spread(opened, spread_mm)
    if by_pixels:
        opened = drop_wrong_circles(opened)
    else:
        opened, _ = drop_wrong_places(opened)
    opened, _ = fit_places(opened)
    return finish_fit(_with_own_spread(opened, _coordinate_spread(opened)), fit.elsewhere)


def _is_shown(opened: Problem) -> bool:
    """Whether free places would take more off the chi-square than chance."""
    gain, chi_square = (
        float(part) for part in _chi_square_gain(opened.state, opened.chart, opened.table)
    )
    unknowns = 3 * len(opened.target)
    left = degrees_of_freedom(opened) - unknowns
    if left <= unknowns:
        return False
    ratio = gain / unknowns / max((chi_square - gain) / left, 1e-300)
    return bool(ratio > 1.0 + TUNING.problem.refuted_sigmas * np.sqrt(2.0 / unknowns + 2.0 / left))


def _may_lie_elsewhere(problem: Problem) -> bool:
    """Whether the board is not said to be exact, and small enough."""
    first = problem.chart.sheet_first
    return bool(np.any(problem.chart.free[first:])) and len(problem.target) <= _MOST_PLACES


def _residual_mm(problem: Problem) -> float:
    """Residuals on the board, at the distance at which it was."""
    focal_px = float(np.mean(np.asarray(problem.state.lenses.focal_length_px)))
    errors = np.concatenate(
        [each[view.kept] for view, each in zip(problem.views, errors_px(problem), strict=True)]
    )
    return float(np.sqrt(np.mean(errors**2)) * problem.chart.unit_mm / focal_px)


def with_free_places(problem: Problem) -> Problem:
    """The problem with free places, where they are drawn."""
    places = len(problem.target)
    state = eqx.tree_at(lambda s: s.shape, problem.state, np.zeros((places, 3)))
    free = np.concatenate([np.asarray(problem.chart.free), np.ones(3 * places)])
    chart = eqx.tree_at(lambda c: c.free, problem.chart, free)
    return problem._replace(state=state, chart=chart)


def _with_spread(problem: Problem, spread_mm: Float[np.ndarray, "3"]) -> Problem:
    chart = eqx.tree_at(lambda c: c.shape_information, problem.chart, spread_mm**-2.0)
    return problem._replace(chart=chart)


def _coordinate_spread(problem: Problem) -> Float[np.ndarray, "3"]:
    return np.asarray(problem.chart.shape_information) ** -0.5


@kept_jit
def _chi_square_gain(state: RigState, chart: Chart, table: ViewTable) -> tuple:
    """What free places would take off the chi-square, to first order, and it."""
    plain = GemanMcClure.from_scale(jnp.full(len(table.shot), jnp.inf))
    equations = PlacesProblem(chart, table, plain).equations(state)
    gain = gauss_newton_gain(equations)
    return gain, jnp.sum(jnp.square(whitened_residuals(state, chart, table)))


def _with_own_spread(problem: Problem, spread_mm: Float[np.ndarray, "3"]) -> Problem:
    """The fit with the spread of the places over the board, and the sigmas, that it shows itself.

    The mean of squares of each axis, posterior variance added, is the next guess of its prior
    (expectation and maximisation); along X and Y there is one.
    """
    for _ in range(MOST_ROUNDS):
        after, determined = expected_spread(problem, spread_mm)
        problem = with_sigma_factors(problem._replace(spent=determined))
        problem, _ = fit_places(_with_spread(problem, after))
        still = np.all(np.abs(np.log(after / spread_mm)) < LEAST_CHANGE)
        spread_mm = after
        if still:
            break
    return problem


def expected_spread(
    problem: Problem, spread_mm: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "3"], float]:
    """(root mean square of the places' coordinates along each axis, their posterior variance
    added; how many of these numbers the shots tell), at the end of a fit under `spread_mm`."""
    places, unit_mm = len(problem.target), float(problem.chart.unit_mm)
    covariance = np.nan_to_num(compute_information(problem).observability.covariance)
    variance = unit_mm**2 * np.diag(covariance)[-3 * places :].reshape(-1, 3)
    squares = np.mean(np.asarray(problem.state.shape) ** 2 + variance, axis=0)
    across = np.mean(squares[:2])
    determined = 3 * places - np.sum(variance / spread_mm**2)
    return np.sqrt([across, across, squares[2]]), float(determined)
