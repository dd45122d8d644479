"""Correction of polynomial lenses by B-splines.

The control points have a prior: the correction is a smooth random surface of mean zero. Where
nothing was observed, only this prior determines the control points. The standard deviation of the
surface over the image, in px, is estimated from the shots for each lens.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.problem import Problem, lens_of_index, with_priors, with_wider_lenses
from trinoc.calib.problem.robust_fit import (
    LEAST_CHANGE,
    MOST_ROUNDS,
    RobustFit,
    errors_px,
    finish_fit,
    fit_points,
    fit_robustly,
    use_all_points,
    with_sigma_factors,
)
from trinoc.geometry.lenses.registry import spline_lens
from trinoc.geometry.lenses.splined import AbstractSplinedLens

# numerical: smallest standard deviation of a correction, for shots that show none.
_LEAST_SIGMA_PX = 1e-3


def with_correction(fit: RobustFit, sizes_px: Sequence[tuple[int, int]]) -> RobustFit:
    """Fit again with the polynomial lenses corrected by splines.

    The polynomial lens may have caused apparent outliers. The new fit therefore uses all points
    again, except those of rejected images.

    sizes_px : (width, height) of the images of each lens.
    """
    problem = use_all_points(add_splines(fit.problem, sizes_px), fit.rejected_images)
    refitted = fit_robustly(_with_sigmas(problem, _first_sigmas_px(problem)))
    return with_estimated_correction_sigmas(
        refitted._replace(rejected_images=[*fit.rejected_images, *refitted.rejected_images])
    )


def with_estimated_correction_sigmas(fit: RobustFit) -> RobustFit:
    """Estimate the prior sigmas of the spline corrections and the sigmas of the points, and fit
    again.

    Both are estimated from the residuals. A fit without splines is returned unchanged.
    """
    if not correction_sigmas_px(fit.problem).any():
        return fit
    return finish_fit(_with_estimated_sigmas(fit.problem), fit.rejected_images)


def add_splines(problem: Problem, sizes_px: Sequence[tuple[int, int]]) -> Problem:
    """Problem in which each lens has a spline correction, which starts at 0 and has no prior.

    sizes_px : (width, height) of the images of each lens.
    """
    lenses = [
        spline_lens(lens_of_index(problem, k), each)
        for k, each in enumerate(sizes_px[: problem.parametrization.lens_shape[0]])
    ]
    return with_wider_lenses(problem, lenses, sizes_px)


def correction_sigmas_px(problem: Problem) -> Float[np.ndarray, "l"]:
    """Prior standard deviation of the spline correction of each lens, px, (l,); 0 if a lens has
    none.
    """
    last_information = np.asarray(problem.priors.lens_information)[:, -1, -1]
    model = type(problem.state.lenses)
    if not issubclass(model, AbstractSplinedLens):
        return np.zeros(len(last_information))
    unit = model.correction_information()[-1, -1]
    return np.sqrt(
        np.divide(
            unit, last_information, out=np.zeros_like(last_information), where=last_information > 0
        )
    )


class LensCorrection(NamedTuple):
    """Size of the spline correction of one lens.

    Attributes
    ----------
    lens : index of the lens.
    model : name of the polynomial model that is corrected.
    rms_px, largest_px : root mean square and largest absolute value of the spline's control points.
    sigma_px : prior standard deviation of the correction. It applies where the image shows no board
        point.
    """

    lens: int
    model: str
    rms_px: float
    largest_px: float
    sigma_px: float


def measure_corrections(problem: Problem) -> list[LensCorrection]:
    """Size of the spline correction of each lens that has one."""
    corrections = []
    for k, sigma_px in enumerate(correction_sigmas_px(problem)):
        if sigma_px == 0.0:
            continue
        lens = lens_of_index(problem, k)
        assert isinstance(lens, AbstractSplinedLens)
        control = np.asarray(lens.control_px)
        rms_px, largest_px = np.sqrt(np.mean(control**2)), np.abs(control).max()
        corrections.append(LensCorrection(k, lens.core.model, rms_px, largest_px, sigma_px))
    return corrections


def _with_estimated_sigmas(problem: Problem) -> Problem:
    """Estimate the prior sigma of each spline correction by maximum evidence, and fit with it.

    In each iteration, the new prior variance, px^2, is the chi-square of the control points under a
    prior with a sigma of 1 px, divided by the effective number of control points that the shots
    determine.

    References
    ----------
    D. J. C. MacKay, "Bayesian interpolation", Neural Computation 4(3), 1992.
    """
    for _ in range(MOST_ROUNDS):
        before = correction_sigmas_px(problem)
        squares, determined = assess_corrections(problem, before)
        after = np.sqrt(np.maximum(squares / np.maximum(determined, 1e-9), _LEAST_SIGMA_PX**2))
        after = np.where(before > 0, after, 0.0)
        problem = with_sigma_factors(problem._replace(lens_dof=float(determined.sum())))
        problem, _ = fit_points(_with_sigmas(problem, after))
        has_correction = before > 0
        if np.all(np.abs(np.log(after[has_correction] / before[has_correction])) < LEAST_CHANGE):
            break
    return problem


def assess_corrections(
    problem: Problem, sigma_px: Float[np.ndarray, "l"]
) -> tuple[Float[np.ndarray, "l"], Float[np.ndarray, "l"]]:
    """Size of the spline correction of each lens, and number of its control points that the shots
    determine.

    sigma_px : (l,) prior sigmas of the fit; 0 for a lens without a correction.

    Returns
    -------
    Size: chi-square of the fitted control points under a prior with a sigma of 1 px, (l,). Number:
    effective number of control points that the shots, and not the prior, determine, (l,).
    """
    information = compute_information(problem)
    covariance = np.nan_to_num(information.observability.covariance)
    model = type(problem.state.lenses)
    assert issubclass(model, AbstractSplinedLens)
    unit, scale = model.correction_information(), np.asarray(problem.parametrization.lens_scale)
    count, size = scale.shape
    has_prior = np.diag(unit) > 0
    squares, determined = np.zeros(count), np.zeros(count)
    for k in np.flatnonzero(sigma_px > 0):
        values = np.asarray(lens_of_index(problem, int(k)).parameters)
        squares[k] = values @ unit @ values
        rows = np.searchsorted(information.free, k * size + np.flatnonzero(has_prior))
        lens_covariance = covariance[np.ix_(rows, rows)] * np.outer(
            scale[k, has_prior], scale[k, has_prior]
        )
        prior_share = (
            np.sum(unit[np.ix_(has_prior, has_prior)] * lens_covariance) / sigma_px[k] ** 2
        )
        determined[k] = has_prior.sum() - prior_share
    return squares, determined


def _with_sigmas(problem: Problem, sigma_px: Float[np.ndarray, "l"]) -> Problem:
    """Problem with a spline prior of the given sigma for each lens; 0 for a lens that is fixed."""
    model = type(problem.state.lenses)
    assert issubclass(model, AbstractSplinedLens)
    inverse = np.divide(1.0, sigma_px**2, out=np.zeros_like(sigma_px), where=sigma_px > 0)
    information = inverse[:, None, None] * model.correction_information()[None]
    return with_priors(problem, lens_information=information)


def _first_sigmas_px(problem: Problem) -> Float[np.ndarray, "l"]:
    """Initial sigma of each lens's spline prior, px: root mean square residual of the fit without
    splines.

    0 for lenses that are fixed.
    """
    count, size = problem.parametrization.lens_shape
    is_free = np.asarray(problem.free)[: count * size].reshape(count, size).any(axis=1)
    errors = [each[view.rows_used] for view, each in zip(problem.views, errors_px(problem))]
    return np.where(is_free, np.sqrt(np.mean(np.concatenate(errors) ** 2)), 0.0)
