"""Robust fit of a problem: outliers left out, sigmas enlarged where residuals contradict them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.equations import PlacesProblem
from trinoc.calib.problem.places import residuals_px, whitened_residuals
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.solver import LEAST_DAMPING, solve
from trinoc.calib.problem.views import SheetPoints
from trinoc.calib.tuning.every_group import TUNING, ProblemTuning
from trinoc.numerics.precision import as_numpy
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: median length of a whitened two-dimensional error under a normal law.
_MEDIAN_LENGTH = 1.1774
# numerical: a direction that has less of the information of the best one is not determined.
_LEAST_SHARE = 1e-3
# numerical: rounds in which the spread of a prior is found, and its relative change at the end.
MOST_ROUNDS, LEAST_CHANGE = 8, 0.05
# numerical: fewer images of a camera do not show which of them is noisier.
_FEWEST_IMAGES = 3
_whitened = kept_jit(whitened_residuals)
_residuals = kept_jit(residuals_px)


def robust_scale(whitened: Float[np.ndarray, "m 2"]) -> float:
    """Standard deviation of whitened errors, from their median length; at least 1."""
    if not len(whitened):
        return 1.0
    return max(1.0, float(np.median(np.linalg.norm(whitened, axis=1))) / _MEDIAN_LENGTH)


def inliers(
    whitened: Float[np.ndarray, "m 2"],
    scale: float | None = None,
    gate: float = TUNING.problem.gate,
) -> Bool[np.ndarray, "m"]:
    """Return which places have an error that noise explains.

    scale : standard deviation of the errors; their own `robust_scale` unless given.
    gate : largest error that noise explains, in standard deviations.
    """
    scale = robust_scale(whitened) if scale is None else scale
    return np.linalg.norm(whitened, axis=1) <= gate * scale


class RobustFit(NamedTuple):
    """Result of a robust fit.

    Fields
    ------
    problem : at the estimate, with the places that are used.
    converged : whether the last solve converged.
    elsewhere : views that show the board elsewhere: (camera, shot, median error in px).
    chi_square, freedom : of the used places, with the enlarged sigmas.
    is_held : whether lenses and board were fixed at the values of another fit.
    """

    problem: Problem
    converged: bool
    elsewhere: list[tuple[int, int, float]]
    chi_square: float
    freedom: int
    is_held: bool = False


def fit_robustly(problem: Problem) -> RobustFit:
    """Fit with ever tighter bounds on outliers, then without them, then with corrected sigmas.

    The sigmas of corners, which users may guess, are estimated from each camera's residuals. Those
    of circles are enlarged where the residuals contradict them.
    """
    return fit_annealed(anneal(problem))


def fit_annealed(problem: Problem) -> RobustFit:
    """The robust fit of a problem that `anneal` has been applied to."""
    problem, elsewhere = drop_wrong_places(problem)
    problem, _ = fit_places(problem)
    return finish_fit(problem, elsewhere)


def anneal(
    problem: Problem, suspects: Sequence[int] | None = None, first_damping: float | None = None
) -> Problem:
    """The problem after fits that bound the influence of places ever more tightly.

    suspects : the views whose places are bounded, each by its own scatter. Unless given, all views
    are, by the scatter of all.
    """
    for factor in problem.tuning.problem.annealing:
        errors = _used_rows(problem, place_errors_in_sigmas(problem))
        scale = np.full(len(problem.views), np.inf)
        if suspects is None:
            scale[:] = factor * robust_scale(np.concatenate(errors))
        else:
            scale[suspects] = [factor * robust_scale(errors[k]) for k in suspects]
        problem, _ = fit_places(problem, scale, first_damping)
    return problem


def fit_without_wrong_places(problem: Problem, suspects: Sequence[int]) -> tuple[Problem, bool]:
    """The fit without those places of some views that noise does not explain, and whether it
    converged. No view is left out as a whole.

    suspects : views with places whose error exceeds the gate at the state of the problem.
    """
    problem, views = anneal(problem, suspects, LEAST_DAMPING), list(problem.views)
    errors = _used_rows(problem, place_errors_in_sigmas(problem))
    for k in suspects:
        used = views[k].used.copy()
        used[used] = inliers(errors[k], gate=problem.tuning.problem.gate)
        views[k] = views[k]._replace(used=used)
    return fit_places(problem._replace(views=tuple(views)), first_damping=LEAST_DAMPING)


def finish_fit(problem: Problem, elsewhere: list[tuple[int, int, float]]) -> RobustFit:
    """Fit with the sigmas that the residuals show."""
    return refit(with_sigma_factors(problem), elsewhere)


def refit(problem: Problem, elsewhere: list[tuple[int, int, float]]) -> RobustFit:
    """Fit with the sigmas as they are."""
    problem, converged = fit_places(problem)
    return end_of_fit(problem, converged, elsewhere)


def end_of_fit(
    problem: Problem, converged: bool, elsewhere: list[tuple[int, int, float]]
) -> RobustFit:
    """Result of a fit that ended at the state of a problem."""
    chi_square = float(np.sum(np.square(place_errors_in_sigmas(problem))))
    return RobustFit(problem, converged, elsewhere, chi_square, degrees_of_freedom(problem))


def fit_places(
    problem: Problem,
    outlier_scale: float | Float[np.ndarray, "_v"] = np.inf,
    first_damping: float | None = None,
) -> tuple[Problem, bool]:
    """The problem at the end of one solve, and whether it converged.

    outlier_scale : in sigmas, at which the influence of places is bounded: of all, or of each view.
    """
    table = problem.table
    scale = np.full(len(table.shot), np.inf)
    scale[: len(problem.views)] = outlier_scale
    observed = PlacesProblem(problem.parametrization, table, GemanMcClure.from_scale(scale))
    end = as_numpy(solve(observed, problem.state, first_damping))
    return problem._replace(state=end.state), bool(end.converged)


def place_errors_in_sigmas(problem: Problem) -> Float[np.ndarray, "v n 2"]:
    """Residuals in sigmas, unused ones zero, padded as the table is."""
    return np.asarray(_whitened(problem.state, problem.parametrization, problem.table))


def errors_px(problem: Problem) -> list[Float[np.ndarray, "_m 2"]]:
    """Predicted minus observed of all places of each view; 0 along a line that has no ends."""
    every = np.asarray(_residuals(problem.state, problem.parametrization, problem.table))
    return [
        rows[: view.rows] if view.shown is None else _project_across(view.shown, rows[: view.rows])
        for rows, view in zip(every, problem.views)
    ]


def _project_across(
    shown: SheetPoints, errors: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2"]:
    """The part of the errors in directions in which the picture shows the place at all."""
    columns = shown.whitening.reshape(len(shown.whitening), -1, 2)
    values, vectors = np.linalg.eigh(np.einsum("nmi,nmj->mij", columns, columns))
    determined = values > _LEAST_SHARE * values[:, -1:]
    return np.einsum("mik,mk,mjk,mj->mi", vectors, determined, vectors, errors)


def _used_rows(
    problem: Problem, errors: Float[np.ndarray, "v n 2"]
) -> list[Float[np.ndarray, "_m 2"]]:
    """The errors of the detected places of each view that take part."""
    return [rows[: len(view.used)][view.used] for rows, view in zip(errors, problem.views)]


def use_all_places(problem: Problem, elsewhere: list[tuple[int, int, float]]) -> Problem:
    """The problem with every place used, except in views that show the board elsewhere."""
    out = {(camera, shot) for camera, shot, _ in elsewhere}
    views = tuple(
        view if (view.camera, view.shot) in out else view._replace(used=np.ones_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


def drop_wrong_places(
    problem: Problem, errors: Float[np.ndarray, "v n 2"] | None = None
) -> tuple[Problem, list[tuple[int, int, float]]]:
    """The problem without places, and without images, that noise does not explain.

    The gate of a place is a multiple of the scatter of its own image, which is at least that of its
    camera and at most a few times that: an image that is blurred or taken in motion is noisier, but
    not wrong.

    errors : residuals in sigmas; those of the problem's state unless given.
    """
    if errors is None:
        errors = place_errors_in_sigmas(problem)
    pixels = errors_px(problem)
    views, elsewhere, tuning = list(problem.views), [], problem.tuning.problem
    for camera in range(problem.cameras):
        rows = [k for k, view in enumerate(problem.views) if view.camera == camera]
        # Unused places have residuals of zero.
        own = {
            k: errors[k][: len(problem.views[k].used)][problem.views[k].used]
            for k in rows
            if problem.views[k].used.any()
        }
        if not own:
            continue
        of_camera = robust_scale(np.concatenate(list(own.values())))
        for k, whitened in own.items():
            most = tuning.noisiest_image * of_camera
            scale = float(np.clip(robust_scale(whitened), of_camera, most))
            right = inliers(whitened, scale, tuning.gate)
            view, used = problem.views[k], problem.views[k].used.copy()
            used[used] = right
            if right.mean() < tuning.fewest_agree:
                miss_px = float(np.median(np.linalg.norm(pixels[k], axis=1)))
                elsewhere.append((view.camera, view.shot, miss_px))
                used[:] = False
            views[k] = view._replace(used=used)
    return problem._replace(views=tuple(views)), elsewhere


def with_sigma_factors(
    problem: Problem,
    squared: Float[np.ndarray, "v"] | None = None,
    freedom: Float[np.ndarray, "v"] | None = None,
) -> Problem:
    """The problem with sigmas multiplied by what the residuals of each camera and image show.

    squared : sum of the squared residuals of each view, in sigmas; computed unless given.
    freedom : their degrees of freedom; unless given, those of the whole fit, shared among the views
    by their numbers of residuals.

    The variance of an image's places is its camera's and its own, weighted by their numbers of
    degrees of freedom, where the camera's counts as `ProblemTuning.image_prior`: weights of groups
    of observations by their residuals, as in variance component estimation.
    """
    if squared is None:
        squared = np.asarray(np.sum(place_errors_in_sigmas(problem) ** 2, axis=(1, 2)))
    if freedom is None:
        numbers = np.array([view.numbers for view in problem.views])
        share = max(degrees_of_freedom(problem), 1) / max(int(numbers.sum()), 1)
        freedom = share * numbers
    are_known = problem.parametrization.has_circles or any(
        v.shown is not None for v in problem.views
    )
    factor, views = np.array(problem.sigma_factor), list(problem.views)
    for camera in range(problem.cameras):
        rows = [k for k, view in enumerate(problem.views) if view.camera == camera and view.numbers]
        total = float(freedom[rows].sum())
        if total <= 0:
            continue
        # In sigmas as they were detected.
        ratio = np.array([views[k].sigma_ratio for k in rows])
        chi_square = squared[rows] * (factor[camera] * ratio) ** 2
        if all(views[k].shown is None for k in rows) and len(rows) >= _FEWEST_IMAGES:
            ratio = _image_ratios(chi_square, freedom[rows], problem.tuning.problem)
            for k, each in zip(rows, ratio.tolist()):
                views[k] = views[k]._replace(sigma_ratio=each)
        reduced = float(np.sum(chi_square / ratio**2) / total)
        refuted = reduced > 1.0 + problem.tuning.problem.refuted_sigmas * np.sqrt(2.0 / total)
        if refuted or not are_known:
            factor[camera] = np.sqrt(max(reduced, 1e-12))
        else:
            factor[camera] = 1.0
    return problem._replace(views=tuple(views), sigma_factor=factor)


def _image_ratios(
    chi_square: Float[np.ndarray, "v"], freedom: Float[np.ndarray, "v"], tuning: ProblemTuning
) -> Float[np.ndarray, "v"]:
    """Scatter of each image over that of its camera, which lies within fixed bounds."""
    prior = tuning.image_prior
    typical = float(np.median(chi_square / np.maximum(freedom, 1e-9)))
    variance = (chi_square / max(typical, 1e-300) + prior) / (freedom + prior)
    return np.clip(np.sqrt(variance), 1 / tuning.noisiest_image, tuning.noisiest_image)


def degrees_of_freedom(problem: Problem) -> int:
    """Residuals less unknowns; those with a prior (sheet, places, lenses) by `Problem.spent`."""
    residuals = sum(view.numbers for view in problem.views)
    shots = {view.shot for view in problem.views if view.used.any()}
    steps = np.array(problem.free[: problem.slices.sheets.start])
    known = np.einsum("lqq->lq", np.asarray(problem.priors.lens_information)) > 0
    steps[problem.slices.lenses][known.ravel()] = 0
    spent = problem.spent + problem.spent_on_lenses
    return residuals - int(steps.sum()) - 6 * len(shots) - round(spent)
