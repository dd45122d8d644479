"""Selection of lens coefficients: those that are determined, and those that the residuals need.

All determined coefficients are estimated, even if a value is within its noise. If such a
coefficient were fixed at 0, the sigmas of the others would be right only if 0 is its true value. In
tests, their errors were then more than twice their sigmas. Estimating it does not increase the
sigma of the focal length.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, refit
from trinoc.geometry.lenses.abstract_lens import AbstractLens

# numerical: least reduction of chi-square by a needed coefficient, as in Akaike's criterion.
_PRICE = 2.0


def fix_undetermined(fit: RobustFit) -> tuple[RobustFit, tuple[str, ...]]:
    """Fix at 0 the lens coefficients that the observations do not determine, and fit again.

    Coefficients are fixed one after the other, in the order of the lens model's `dispensable`,
    until all remaining parameters are determined. If this does not succeed, the given fit is
    returned.

    Returns
    -------
    The fit, and the names of the fixed coefficients.
    """
    first_fit, fixed = fit, []
    lenses = fit.problem.state.lenses
    for name in ("", *lenses.dispensable):
        if name:
            column, free = lenses.parameter_names.index(name), free_of_lenses(fit.problem)
            if not free[:, column].any():
                continue
            free[:, column] = False
            fit = refit(with_lens_free(fit.problem, free), fit.rejected_images)
            fixed.append(name)
        information = compute_information(fit.problem)
        if information.observability.rank == len(information.free):
            return fit, tuple(fixed)
    return first_fit, ()


def free_of_lenses(problem: Problem) -> Bool[np.ndarray, "l q"]:
    """Mask of the estimated parameters, (l, q) for l lenses of q parameters."""
    return np.asarray(problem.free)[problem.slices.lenses].reshape(
        problem.parametrization.lens_shape
    ) > 0  # fmt: skip


def fewest_coefficients(
    lens: AbstractLens, free: Sequence[str], covariance: Float[np.ndarray, "q q"]
) -> tuple[int, float]:
    """Number of distortion coefficients with the best Akaike criterion.

    Returns this number, and the increase of chi-square if all other coefficients were 0 (Wald
    test).

    Parameters
    ----------
    lens : fitted lens.
    free : names of its estimated coefficients.
    covariance : (q, q) covariance of all q parameters of the lens.
    """
    names, scores = lens.parameter_names, []
    for count in lens.coefficient_counts:
        needed = lens.coefficient_names[:count]
        if set(needed) <= set(free):
            rows = [names.index(name) for name in free if name not in needed]
            values = np.asarray(lens.parameters)[rows]
            gain = float(values @ np.linalg.solve(covariance[np.ix_(rows, rows)], values))
            scores.append((gain + _PRICE * len(needed), count, gain))
    _, count, gain = min(scores)
    return count, gain
