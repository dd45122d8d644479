"""How many coefficients of the lenses are determined, and how many are called for.

All that are determined stay free. Leaving out a coefficient because it is within its noise would
lend the others sigmas that hold only if it is exactly zero: measured, their errors were then
more than twice the claimed sigmas, while freeing it costs the focal length nothing.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, refit
from trinoc.geometry.lenses.abstract_lens import AbstractLens

# numerical: what a coefficient must lower chi-square by to be called for, Akaike's price.
_PRICE = 2.0


def hold_undetermined(fit: RobustFit) -> tuple[RobustFit, tuple[str, ...]]:
    """The fit with as many coefficients as are determined, and those that are held at 0 instead.

    Those that the lenses' model calls dispensable are held one after the other; none are where
    what remains is not determined either.
    """
    richest, held = fit, []
    lenses = fit.problem.state.lenses
    for name in ("", *lenses.dispensable):
        if name:
            column, free = lenses.parameter_names.index(name), free_of_lenses(fit.problem)
            if not free[:, column].any():
                continue
            free[:, column] = False
            fit = refit(with_lens_free(fit.problem, free), fit.elsewhere)
            held.append(name)
        information = compute_information(fit.problem)
        if information.observability.rank == len(information.free):
            return fit, tuple(held)
    return richest, ()


def free_of_lenses(problem: Problem) -> Bool[np.ndarray, "l q"]:
    """Which parameters of each lens are fitted."""
    return np.asarray(problem.free)[problem.slices.lenses].reshape(
        problem.parametrization.lens_shape
    ) > 0  # fmt: skip


def fewest_coefficients(
    lens: AbstractLens, free: Sequence[str], covariance: Float[np.ndarray, "q q"]
) -> tuple[int, float]:
    """The number of coefficients that pays best, and what the others lower chi-square by (Wald).

    free : names of those that are fitted. covariance : of all parameters of the lens.
    """
    names, offers = lens.parameter_names, []
    for count in lens.coefficient_counts:
        kept = lens.coefficient_names[:count]
        if set(kept) <= set(free):
            rows = [names.index(name) for name in free if name not in kept]
            values = np.asarray(lens.parameters)[rows]
            gain = float(values @ np.linalg.solve(covariance[np.ix_(rows, rows)], values))
            offers.append((gain + _PRICE * len(kept), count, gain))
    _, count, gain = min(offers)
    return count, gain
