"""Calibration problem of one camera that observes points, and selection of its lens parameters."""

import dataclasses
from collections.abc import Collection
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.problem import (
    Problem,
    lens_of_index,
    with_free_parameters,
    with_priors,
    with_wider_lenses,
)
from trinoc.calib.problem.rao_test import FixedScore
from trinoc.calib.problem.robust_fit import errors_px, fit_points
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError
from trinoc.geometry.camera import Camera
from trinoc.geometry.lenses.registry import DEFAULT_DISTORTION
from trinoc.geometry.lenses.skewed import SKEW, skew_lens
from trinoc.geometry.pose import Pose, PoseModel

# numerical: rounds of outlier rejection; the first few usually converge.
_CUTS = 4
# numerical: residuals of this size are rounding.
ROUNDING_PX = 1e-7
# numerical: singular values below this share are rounding.
_OPEN_SHARE = 1e-11
# numerical: fits after which the noise, and with it the weight of a prior, no longer changes.
_PRIOR_ROUNDS = 3
# Name of the only camera.
CAMERA = "camera"


class _Points(AbstractTarget):
    """Calibration target that consists of points anywhere in space.

    Attributes
    ----------
    centres_mm : (n, 3) world coordinates of the points.
    """

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "n 3"]
    radius_mm: Float[np.ndarray, "n"]


def problem_of_points(
    camera: Camera,
    points_mm: Float[np.ndarray, "n 3"],
    uv_px: Float[np.ndarray, "n 2"],
    names: tuple[str, ...],
    model: PoseModel,
    tuning: CalibTuning = TUNING,
) -> Problem:
    """Calibration problem of one camera that observes points with known coordinates.

    The lens is converted to a more general model with the same values; additional parameters are 0.

    Parameters
    ----------
    camera : initial camera.
    points_mm : (n, 3) world coordinates.
    uv_px : (n, 2) observed pixels.
    names : names of the lens parameters to estimate.
    model : pose parameters to estimate.
    tuning : constants of the method.
    """
    count = len(points_mm)
    unit = np.broadcast_to(np.eye(2), (count, 2, 2))
    no_lines = np.full((2, 3), np.nan)
    detection = Detection(np.arange(count), uv_px, unit, unit, no_lines, camera.image_size_px)
    pose = camera.pose.aim_at_origin() if model is PoseModel.AIMED else camera.pose
    target = _Points("points", points_mm, np.zeros(count))
    sheet_camera = SheetCamera(CAMERA, detection, camera.intrinsics, None, pose)
    problem = sheet_problem([sheet_camera], target, SheetPriors(model, Systematics(), tuning))
    count, _ = problem.parametrization.lens_shape
    lenses = [skew_lens(lens_of_index(problem, k)) for k in range(count)]
    problem = with_wider_lenses(problem, lenses, [camera.image_size_px] * count)
    return with_lens_parameters_free(problem, names)


def with_lens_parameters_free(problem: Problem, names: Collection[str]) -> Problem:
    """Problem in which, of all lens parameters, only those with the given names are estimated.

    The estimated pose parameters do not change.
    """
    free = np.array(problem.free)
    free[problem.slices.lens(0)] = [name in names for name in lens_parameter_names(problem)]
    return with_free_parameters(problem, free)


def fit_without_outliers(problem: Problem) -> Problem:
    """Fit a problem from `problem_of_points` repeatedly, until its outliers no longer change.

    Raises `CalibrationError` if the fit does not converge, or if a used point is behind the camera.
    """
    (view,) = problem.views
    for _ in range(_CUTS):
        problem, converged = fit_points(problem._replace(views=(view,)))
        pose = Pose(np.asarray(problem.state.cam_from_rig)[0])
        in_front = (problem.target.centres_mm @ pose.rotation[2] + pose.translation_mm[2]) > 0
        if not (converged and in_front[view.used].all()):
            raise CalibrationError(
                f"The fit to {int(view.used.sum())} points did not converge: check that the "
                "points, the pixels and the lens belong together."
            )
        error_px = np.linalg.norm(errors_px(problem)[0], axis=1)
        # The median of a Rayleigh distribution is 1.18 sigma.
        inlier = (
            error_px <= problem.tuning.problem.gate * np.median(error_px[view.used]) / 1.18 + 1e-9
        )
        if np.array_equal(inlier, view.used):
            break
        view = view._replace(used=inlier)
    return problem


def extend_lens(problem: Problem, names: tuple[str, ...]) -> tuple[Problem, tuple[str, ...]]:
    """Estimate additional lens parameters as long as the points need them (forward selection).

    Each round adds the group of coefficients, or the skew, with the smallest p-value. A skew that
    later coefficients make unnecessary is fixed at 0 again. Returns the fit and the names of its
    estimated lens parameters.

    problem : fit with only the parameters `names` estimated.
    """
    all_names, coefficients = lens_parameter_names(problem), DEFAULT_DISTORTION.coefficient_names
    coefficient_groups = [coefficients[:count] for count in DEFAULT_DISTORTION.coefficient_counts]
    without_skew = None
    while True:
        score, candidates = score_of_points(problem), []
        for candidate in (*coefficient_groups, (SKEW,)):
            columns = [all_names.index(name) for name in candidate if name not in names]
            if columns:
                candidates.append((*score.rank(score.test(columns)), candidate))
        p_value, _, group = min(candidates, default=(1.0, 0.0, ()))
        if p_value * len(candidates) > problem.tuning.answer.chance or not candidates:
            break
        without_skew = problem if group == (SKEW,) else without_skew
        names = tuple(name for name in all_names if name in {*names, *group})
        problem = _fit_with_free(problem, names)
    if without_skew is None:
        return problem, names
    names_without_skew = tuple(name for name in names if name != SKEW)
    try:
        fixed_skew = _fit_with_free(without_skew, names_without_skew)
    except CalibrationError:  # without a skew the points have no fit
        return problem, names
    score = score_of_points(fixed_skew)
    is_unnecessary = (
        score.p_value(score.test([all_names.index(SKEW)])) > problem.tuning.answer.chance
    )
    return (fixed_skew, names_without_skew) if is_unnecessary else (problem, names)


def _fit_with_free(problem: Problem, names: tuple[str, ...]) -> Problem:
    """Fit in which only the parameters `names` of the lens are estimated, and the pose.

    Outliers are searched again among all points.
    """
    used = np.ones(len(problem.views[0].used), dtype=bool)
    problem = problem._replace(views=(problem.views[0]._replace(used=used),))
    return fit_without_outliers(with_lens_parameters_free(problem, names))


def lens_parameter_names(problem: Problem) -> tuple[str, ...]:
    """Names of all parameters of the problem's lens model, estimated or not."""
    return problem.state.lenses.parameter_names


def score_of_points(problem: Problem) -> FixedScore:
    """Normal equations for score tests of fixed parameters, with the estimated parameters
    eliminated.

    They have one row for each parameter of the problem, estimated ones included. Residuals are in
    px, since points have no stated sigma.
    """
    linearised, (view,) = whiten_views(problem), problem.views
    fitted = np.flatnonzero(problem.free)
    rows = np.flatnonzero(np.repeat(view.used, 2))
    jacobian, residual = linearised.jacobian[0][rows], linearised.residual[0][rows]
    base, values, _ = np.linalg.svd(jacobian[:, fitted], full_matrices=False)
    base = base[:, values > _OPEN_SHARE * values[0]]
    remaining = jacobian - base @ (base.T @ jacobian)
    residual = residual - base @ (base.T @ residual)
    squared = float(residual @ residual)
    return FixedScore(
        information=remaining.T @ remaining,
        gradient=remaining.T @ residual,
        total_information=np.sum(jacobian**2, axis=0),
        squared=squared,
        freedom=len(rows) - base.shape[1],
        are_exact=squared < ROUNDING_PX**2 * len(residual),
    )


class FitUnderPrior(NamedTuple):
    """Fit in which the uncertain lens parameters are estimated with their prior.

    Attributes
    ----------
    problem : the problem at its solution.
    strain : largest difference from the prior mean along a principal axis of the prior, in sigmas.
    """

    problem: Problem
    strain: float


def fit_under_prior(
    problem: Problem, names: Collection[str], lens_errors: Float[np.ndarray, "q r"]
) -> FitUnderPrior:
    """Fit again, with the uncertain lens parameters estimated under their prior.

    Parameters
    ----------
    problem : fit with only the lens parameters `names` estimated.
    names : names of the lens parameters without a prior.
    lens_errors : (q, r) change of the q lens parameters for one sigma of each of r errors of the
        given lens. Parameters with zeros are exact.

    Returns
    -------
    The fit. The parametrization of its problem is that of the given problem.
    """
    parametrization, (view,) = problem.parametrization, problem.views
    count, size = parametrization.lens_shape
    scale = np.asarray(parametrization.lens_scale)[0]
    mean = np.asarray(lens_of_index(problem, 0).parameters)
    directions, sizes, _ = np.linalg.svd(lens_errors / scale[:, None], full_matrices=False)
    is_uncertain = sizes > _OPEN_SHARE * sizes[0]
    steps = int(is_uncertain.sum())
    factor = scale[:, None] * directions[:, is_uncertain] * sizes[is_uncertain]
    inverse = np.linalg.pinv(factor / scale[:, None]) / scale
    rows = [row for row, name in enumerate(lens_parameter_names(problem)) if name in names]
    basis, means = np.array(parametrization.lens_basis), np.array(problem.priors.lens_mean)
    basis[0] = 0.0
    basis[0][:, :steps] = factor
    basis[0][rows, steps + np.arange(len(rows))] = scale[rows]
    means[0] = mean
    free = np.array(parametrization.free)
    free[:size] = np.arange(size) < steps + len(rows)
    freedom = max(2 * int(view.used.sum()) - int(free.sum()) + steps, 1)
    fitted = problem
    for _ in range(_PRIOR_ROUNDS):
        # Residuals are in px: the prior is weighted by their variance.
        variance = float(np.sum(errors_px(fitted)[0][view.used] ** 2)) / freedom
        information = np.zeros((count, size, size))
        information[0] = variance * inverse.T @ inverse
        with_prior = with_priors(fitted, lens_mean=means, lens_information=information)
        parametrization_with_prior = dataclasses.replace(
            with_prior.parametrization, lens_basis=basis, free=free
        )
        fitted, _ = fit_points(with_prior._replace(parametrization=parametrization_with_prior))
    errors = inverse @ (np.asarray(lens_of_index(fitted, 0).parameters) - mean)
    return FitUnderPrior(
        fitted._replace(parametrization=parametrization), float(np.abs(errors).max())
    )
