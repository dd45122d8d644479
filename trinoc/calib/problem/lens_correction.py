"""The correction of lenses by B-splines, fitted after their polynomial cores.

The control points have a prior, so that those which no place was seen near are known, too: the
correction is a smooth random surface of mean zero. Its standard deviation over the field, in px,
is what the shots themselves show, of each lens by itself.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, lens_number, with_priors, with_wider_lenses
from trinoc.calib.problem.robust_fit import (
    LEAST_CHANGE,
    MOST_ROUNDS,
    RobustFit,
    errors_px,
    finish_fit,
    fit_places,
    fit_robustly,
    use_all_places,
    with_sigma_factors,
)
from trinoc.geometry.lenses.registry import spline_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens

# numerical: a correction of which the shots show nothing is taken to be no larger than this.
_LEAST_SIGMA_PX = 1e-3


def with_correction(fit: RobustFit, sizes_px: Sequence[tuple[int, int]]) -> RobustFit:
    """The fit with its lenses corrected. sizes_px : (width, height) of the pictures of each.

    Places that seemed to be located wrongly may only have been seen through another lens than the
    core: all take part again, but for views that show the board elsewhere.
    """
    problem = use_all_places(add_splines(fit.problem, sizes_px), fit.elsewhere)
    again = fit_robustly(_with_sigmas(problem, _first_sigmas_px(problem)))
    return with_own_correction_sigmas(again._replace(elsewhere=[*fit.elsewhere, *again.elsewhere]))


def with_own_correction_sigmas(fit: RobustFit) -> RobustFit:
    """The fit with the size of each correction, and the sigmas of the places, that it shows."""
    if not correction_sigmas_px(fit.problem).any():
        return fit
    return finish_fit(_with_own_sigmas(fit.problem), fit.elsewhere)


def add_splines(problem: Problem, sizes_px: Sequence[tuple[int, int]]) -> Problem:
    """The problem with splined lenses, whose corrections are zero and free, without a prior."""
    lenses = [
        spline_lens(lens_number(problem, k), each)
        for k, each in enumerate(sizes_px[: problem.parametrization.lens_shape[0]])
    ]
    return with_wider_lenses(problem, lenses, sizes_px)


def correction_sigmas_px(problem: Problem) -> Float[np.ndarray, "l"]:
    """Standard deviation of the correction of each lens over its field, by its prior; 0 where it
    has none."""
    last = np.asarray(problem.priors.lens_information)[:, -1, -1]
    model = type(problem.state.lenses)
    if not issubclass(model, AbstractSplinedLens):
        return np.zeros(len(last))
    unit = model.correction_information()[-1, -1]
    return np.sqrt(np.divide(unit, last, out=np.zeros_like(last), where=last > 0))


def correction_sentences(problem: Problem, cameras: Sequence[str]) -> tuple[str, ...]:
    """How far splines move the pixels of each lens that they correct."""
    sentences = []
    for k, sigma_px in enumerate(correction_sigmas_px(problem)):
        if sigma_px == 0.0:
            continue
        lens = lens_number(problem, k)
        assert isinstance(lens, AbstractSplinedLens)
        first = cameras[
            int(np.flatnonzero(np.asarray(problem.parametrization.lens_of_camera) == k)[0])
        ]
        control = np.asarray(lens.control_px)
        sentences.append(
            f"Splines correct the lens {lens.core.model} of {first} by "
            f"{np.sqrt(np.mean(control**2)):.2g} px (root mean square of the control points, at "
            f"most {np.abs(control).max():.2g}); where no place was seen, the correction is known "
            f"to {sigma_px:.2g} px."
        )
    return tuple(sentences)


def _with_own_sigmas(problem: Problem) -> Problem:
    """The fit with the corrections' sigmas of greatest evidence.

    For each lens the chi-square of its control points under a prior of 1 px, over how many of
    them the shots tell, is the next guess of the variance. Source: D. J. C. MacKay, "Bayesian
    interpolation", Neural Computation 4(3), 1992.
    """
    for _ in range(MOST_ROUNDS):
        before = correction_sigmas_px(problem)
        squares, determined = assess_corrections(problem, before)
        after = np.sqrt(np.maximum(squares / np.maximum(determined, 1e-9), _LEAST_SIGMA_PX**2))
        after = np.where(before > 0, after, 0.0)
        problem = with_sigma_factors(problem._replace(spent_on_lenses=float(determined.sum())))
        problem, _ = fit_places(_with_sigmas(problem, after))
        fitted_ones = before > 0
        if np.all(np.abs(np.log(after[fitted_ones] / before[fitted_ones])) < LEAST_CHANGE):
            break
    return problem


def assess_corrections(
    problem: Problem, sigma_px: Float[np.ndarray, "l"]
) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l"]]:
    """Of each lens, the chi-square of its correction under a sigma of 1 px, and how many numbers
    of it the shots tell, at the end of a fit under priors of `sigma_px`."""
    information = compute_information(problem)
    covariance = np.nan_to_num(information.observability.covariance)
    model = type(problem.state.lenses)
    assert issubclass(model, AbstractSplinedLens)
    unit, scale = model.correction_information(), np.asarray(problem.parametrization.lens_scale)
    count, size = scale.shape
    known = np.diag(unit) > 0
    squares, determined = np.zeros(count), np.zeros(count)
    for k in np.flatnonzero(sigma_px > 0):
        values = np.asarray(lens_number(problem, int(k)).parameters)
        squares[k] = values @ unit @ values
        rows = np.searchsorted(information.free, k * size + np.flatnonzero(known))
        own = covariance[np.ix_(rows, rows)] * np.outer(scale[k, known], scale[k, known])
        of_prior = np.sum(unit[np.ix_(known, known)] * own) / sigma_px[k] ** 2
        determined[k] = known.sum() - of_prior
    return squares, determined


def _with_sigmas(problem: Problem, sigma_px: Float[np.ndarray, "l"]) -> Problem:
    """The problem with priors of these sigmas; those of 0 are of lenses that are held."""
    model = type(problem.state.lenses)
    assert issubclass(model, AbstractSplinedLens)
    inverse = np.divide(1.0, sigma_px**2, out=np.zeros_like(sigma_px), where=sigma_px > 0)
    information = inverse[:, None, None] * model.correction_information()[None]
    return with_priors(problem, lens_information=information)


def _first_sigmas_px(problem: Problem) -> Float[np.ndarray, "l"]:
    """What the core leaves, for lenses that are fitted."""
    count, size = problem.parametrization.lens_shape
    is_free = np.asarray(problem.free)[: count * size].reshape(count, size).any(axis=1)
    errors = [each[view.kept] for view, each in zip(problem.views, errors_px(problem))]
    return np.where(is_free, np.sqrt(np.mean(np.concatenate(errors) ** 2)), 0.0)
