"""Robust fit of a problem: outliers are removed, and sigmas are adapted to the residuals."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.problem.equations import PointsProblem
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.reprojection import residuals_px, whitened_residuals
from trinoc.calib.problem.solver import LEAST_DAMPING, solve
from trinoc.calib.problem.views import SheetPoints
from trinoc.calib.tuning.every_group import TUNING, ProblemTuning
from trinoc.numerics.precision import as_numpy
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: median length of a two-dimensional standard normal vector.
_MEDIAN_LENGTH = 1.1774
# numerical: a direction with a smaller share of the largest information is not determined.
_LEAST_SHARE = 1e-3
# numerical: rounds that estimate the variance of a prior, and its relative change at the end.
MOST_ROUNDS, LEAST_CHANGE = 8, 0.05
# numerical: fewer images of a camera do not show which of them is noisier.
_FEWEST_IMAGES = 3
_whitened = kept_jit(whitened_residuals)
_residuals = kept_jit(residuals_px)


def robust_scale(whitened: Float[np.ndarray, "m 2"]) -> float:
    """Robust standard deviation of whitened errors, from their median length; at least 1."""
    if not len(whitened):
        return 1.0
    return max(1.0, float(np.median(np.linalg.norm(whitened, axis=1))) / _MEDIAN_LENGTH)


def inliers(
    whitened: Float[np.ndarray, "m 2"],
    scale: float | None = None,
    gate: float = TUNING.problem.gate,
) -> Bool[np.ndarray, "m"]:
    """Mask, (m,), of the points whose whitened error is at most `gate` standard deviations long.

    whitened : errors in units of their sigmas.
    scale : standard deviation of the whitened errors. Default: their `robust_scale`.
    """
    scale = robust_scale(whitened) if scale is None else scale
    return np.linalg.norm(whitened, axis=1) <= gate * scale


class RobustFit(NamedTuple):
    """Result of a robust fit of a calibration problem.

    Attributes
    ----------
    problem : the problem at its solution; outliers are marked as unused.
    converged : whether the last fit converged.
    rejected_images : (camera index, shot index, median error in px) of each image that was rejected
        as a whole. Such an image shows the board at another pose.
    chi_square, freedom : chi-square of the used points with the final sigmas, and its degrees of
        freedom.
    lenses_fixed : whether lenses and board were fixed at the values of another fit.
    """

    problem: Problem
    converged: bool
    rejected_images: list[tuple[int, int, float]]
    chi_square: float
    freedom: int
    lenses_fixed: bool = False


def fit_robustly(problem: Problem) -> RobustFit:
    """Fit a problem that has outliers, and estimate the sigmas of its points.

    1. Fits with a robust loss whose width decreases.
    2. A fit without outliers.
    3. A fit with sigmas from the residuals. The given sigmas of corners may be guesses: they are
       replaced. The given sigmas of circles are only multiplied by a factor if the residuals
       contradict them.
    """
    return fit_annealed(anneal(problem))


def fit_annealed(problem: Problem) -> RobustFit:
    """Remove the outliers of a problem returned by `anneal`, estimate its sigmas, and fit again."""
    problem, rejected_images = drop_wrong_points(problem)
    problem, _ = fit_points(problem)
    return finish_fit(problem, rejected_images)


def anneal(
    problem: Problem, suspects: Sequence[int] | None = None, first_damping: float | None = None
) -> Problem:
    """Fit several times with a robust loss whose width decreases.

    suspects : indices of the observations with outliers. Only they have the robust loss, with a
        width proportional to the scatter of the observation. Default: all observations, with one
        width proportional to their common scatter.
    first_damping : damping of the first step of each fit.
    """
    for factor in problem.tuning.problem.annealing:
        errors = _used_rows(problem, whitened_errors(problem))
        scale = np.full(len(problem.views), np.inf)
        if suspects is None:
            scale[:] = factor * robust_scale(np.concatenate(errors))
        else:
            scale[suspects] = [factor * robust_scale(errors[k]) for k in suspects]
        problem, _ = fit_points(problem, scale, first_damping)
    return problem


def fit_without_wrong_points(problem: Problem, suspects: Sequence[int]) -> tuple[Problem, bool]:
    """Fit after removing the outliers of some observations. Returns the problem and whether it
    converged.

    No observation is rejected as a whole.

    suspects : indices of the observations whose outliers are removed.
    """
    problem, views = anneal(problem, suspects, LEAST_DAMPING), list(problem.views)
    errors = _used_rows(problem, whitened_errors(problem))
    for k in suspects:
        used = views[k].used.copy()
        used[used] = inliers(errors[k], gate=problem.tuning.problem.gate)
        views[k] = views[k]._replace(used=used)
    return fit_points(problem._replace(views=tuple(views)), first_damping=LEAST_DAMPING)


def finish_fit(problem: Problem, rejected_images: list[tuple[int, int, float]]) -> RobustFit:
    """Estimate the point sigmas from the residuals, and fit again.

    Outliers must have been marked as unused before.
    """
    return refit(with_sigma_factors(problem), rejected_images)


def refit(problem: Problem, rejected_images: list[tuple[int, int, float]]) -> RobustFit:
    """Fit the used points with their present sigmas, without a robust loss."""
    problem, converged = fit_points(problem)
    return end_of_fit(problem, converged, rejected_images)


def end_of_fit(
    problem: Problem, converged: bool, rejected_images: list[tuple[int, int, float]]
) -> RobustFit:
    """Build the result of a fit whose solution is the state of a problem."""
    chi_square = float(np.sum(np.square(whitened_errors(problem))))
    return RobustFit(problem, converged, rejected_images, chi_square, degrees_of_freedom(problem))


def fit_points(
    problem: Problem,
    outlier_scale: float | Float[np.ndarray, "_v"] = np.inf,
    first_damping: float | None = None,
) -> tuple[Problem, bool]:
    """Minimise the cost of a problem once. Returns the problem at its solution, and whether it
    converged.

    outlier_scale : width of the robust loss, in sigmas; one value, or one for each observation.
        Default: no robust loss.
    first_damping : damping of the first step.
    """
    table = problem.table
    scale = np.full(len(table.shot), np.inf)
    scale[: len(problem.views)] = outlier_scale
    observed = PointsProblem(problem.parametrization, table, GemanMcClure.from_scale(scale))
    end = as_numpy(solve(observed, problem.state, first_damping))
    return problem._replace(state=end.state), bool(end.converged)


def whitened_errors(problem: Problem) -> Float[np.ndarray, "v n 2"]:
    """Predicted minus observed pixels in sigmas, (v, n, 2), padded like `ObservationTable`; 0 for
    unused points.
    """
    return np.asarray(_whitened(problem.state, problem.parametrization, problem.table))


def errors_px(problem: Problem) -> list[Float[np.ndarray, "_m 2"]]:
    """Predicted minus observed pixels of the m points of each observation, used or not.

    For a piece of a line, the component along the line is 0, since the image does not determine it.
    """
    table_errors = np.asarray(_residuals(problem.state, problem.parametrization, problem.table))
    return [
        rows[: view.row_count]
        if view.grey_level_points is None
        else _project_across(view.grey_level_points, rows[: view.row_count])
        for rows, view in zip(table_errors, problem.views)
    ]


def _project_across(
    points: SheetPoints, errors: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2"]:
    """Errors of points without their components in directions that the image does not determine.

    For a piece of a line, this is the direction of the line.
    """
    columns = points.whitening.reshape(len(points.whitening), -1, 2)
    values, vectors = np.linalg.eigh(np.einsum("nmi,nmj->mij", columns, columns))
    determined = values > _LEAST_SHARE * values[:, -1:]
    return np.einsum("mik,mk,mjk,mj->mi", vectors, determined, vectors, errors)


def _used_rows(
    problem: Problem, errors: Float[np.ndarray, "v n 2"]
) -> list[Float[np.ndarray, "_m 2"]]:
    """Errors of the used points of each observation, from a padded table of errors."""
    return [rows[: len(view.used)][view.used] for rows, view in zip(errors, problem.views)]


def use_all_points(problem: Problem, rejected_images: list[tuple[int, int, float]]) -> Problem:
    """Problem in which all points are used, except those of rejected images."""
    rejected = {(camera, shot) for camera, shot, _ in rejected_images}
    views = tuple(
        view
        if (view.camera, view.shot) in rejected
        else view._replace(used=np.ones_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


def drop_wrong_points(
    problem: Problem, errors: Float[np.ndarray, "v n 2"] | None = None
) -> tuple[Problem, list[tuple[int, int, float]]]:
    """Mark outlier points, and all points of outlier images, as unused.

    Returns the problem and the rejected images as (camera index, shot index, median error in px).
    The largest accepted error is a multiple of the scatter of the image. The scatter of an image is
    limited to between 1 and a few times that of its camera: a blurred image has more noise, but is
    not wrong.

    errors : residuals in sigmas. Default: those of the problem's state.
    """
    if errors is None:
        errors = whitened_errors(problem)
    pixel_errors = errors_px(problem)
    views, rejected, tuning = list(problem.views), [], problem.tuning.problem
    for camera in range(problem.cameras):
        rows = [k for k, view in enumerate(problem.views) if view.camera == camera]
        # Unused points have residuals of zero.
        used_errors = {
            k: errors[k][: len(problem.views[k].used)][problem.views[k].used]
            for k in rows
            if problem.views[k].used.any()
        }
        if not used_errors:
            continue
        camera_scale = robust_scale(np.concatenate(list(used_errors.values())))
        for k, whitened in used_errors.items():
            largest = tuning.noisiest_image * camera_scale
            scale = float(np.clip(robust_scale(whitened), camera_scale, largest))
            is_inlier = inliers(whitened, scale, tuning.gate)
            view, used = problem.views[k], problem.views[k].used.copy()
            used[used] = is_inlier
            if is_inlier.mean() < tuning.fewest_agree:
                error_px = float(np.median(np.linalg.norm(pixel_errors[k], axis=1)))
                rejected.append((view.camera, view.shot, error_px))
                used[:] = False
            views[k] = view._replace(used=used)
    return problem._replace(views=tuple(views)), rejected


def with_sigma_factors(
    problem: Problem,
    squared: Float[np.ndarray, "v"] | None = None,
    freedom: Float[np.ndarray, "v"] | None = None,
) -> Problem:
    """Estimate factors of the point sigmas, for each camera and each image, from the residuals.

    The variance of an image is a weighted mean of its own variance and that of its camera, with
    degrees of freedom as weights. The camera has the weight `ProblemTuning.image_prior`. This is
    variance component estimation.

    Parameters
    ----------
    squared : (v,) sum of the squared residuals of each observation, in sigmas. Default: computed.
    freedom : (v,) degrees of freedom of these sums. Default: those of the whole fit, distributed in
        proportion to the numbers of residuals.
    """
    if squared is None:
        squared = np.asarray(np.sum(whitened_errors(problem) ** 2, axis=(1, 2)))
    if freedom is None:
        coordinates = np.array([view.coordinate_count for view in problem.views])
        share = max(degrees_of_freedom(problem), 1) / max(int(coordinates.sum()), 1)
        freedom = share * coordinates
    sigmas_are_known = problem.parametrization.has_circles or any(
        v.grey_level_points is not None for v in problem.views
    )
    factor, views = np.array(problem.sigma_factor), list(problem.views)
    for camera in range(problem.cameras):
        rows = [
            k
            for k, view in enumerate(problem.views)
            if view.camera == camera and view.coordinate_count
        ]
        total = float(freedom[rows].sum())
        if total <= 0:
            continue
        # In sigmas as they were detected.
        ratio = np.array([views[k].sigma_ratio for k in rows])
        chi_square = squared[rows] * (factor[camera] * ratio) ** 2
        if all(views[k].grey_level_points is None for k in rows) and len(rows) >= _FEWEST_IMAGES:
            ratio = _image_ratios(chi_square, freedom[rows], problem.tuning.problem)
            for k, image_ratio in zip(rows, ratio.tolist()):
                views[k] = views[k]._replace(sigma_ratio=image_ratio)
        reduced = float(np.sum(chi_square / ratio**2) / total)
        contradicts = reduced > 1.0 + problem.tuning.problem.refuted_sigmas * np.sqrt(2.0 / total)
        if contradicts or not sigmas_are_known:
            factor[camera] = np.sqrt(max(reduced, 1e-12))
        else:
            factor[camera] = 1.0
    return problem._replace(views=tuple(views), sigma_factor=factor)


def _image_ratios(
    chi_square: Float[np.ndarray, "v"], freedom: Float[np.ndarray, "v"], tuning: ProblemTuning
) -> Float[np.ndarray, "v"]:
    """Scatter of each image divided by that of its camera, limited to fixed bounds, (v,).

    chi_square, freedom : sum of squared residuals of each image, and its degrees of freedom.
    """
    prior = tuning.image_prior
    typical = float(np.median(chi_square / np.maximum(freedom, 1e-9)))
    variance = (chi_square / max(typical, 1e-300) + prior) / (freedom + prior)
    return np.clip(np.sqrt(variance), 1 / tuning.noisiest_image, tuning.noisiest_image)


def degrees_of_freedom(problem: Problem) -> int:
    """Number of residuals minus the number of estimated parameters.

    Parameters with a prior (print, bend, board points, lenses) count only as far as the residuals
    determine them: `shape_dof` and `lens_dof`.
    """
    residuals = sum(view.coordinate_count for view in problem.views)
    shots = {view.shot for view in problem.views if view.used.any()}
    steps = np.array(problem.free[: problem.slices.sheets.start])
    has_prior = np.einsum("lqq->lq", np.asarray(problem.priors.lens_information)) > 0
    steps[problem.slices.lenses][has_prior.ravel()] = 0
    determined = problem.shape_dof + problem.lens_dof
    return residuals - int(steps.sum()) - 6 * len(shots) - round(determined)
