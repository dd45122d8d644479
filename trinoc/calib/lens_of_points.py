"""The problem of one camera that sees points, and the lens that they ask for."""

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
    lens_number,
    with_head_free,
    with_priors,
    with_wider_lenses,
)
from trinoc.calib.problem.rao_test import HeldScore
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError
from trinoc.geometry.camera import Camera
from trinoc.geometry.lenses.registry import DEFAULT_DISTORTION
from trinoc.geometry.lenses.skewed import SKEW, skew_lens
from trinoc.geometry.pose import Pose, PoseModel

# numerical: rounds in which outliers are left out, few of which change something.
_CUTS = 4
# numerical: residuals of this size are rounding.
ROUNDING_PX = 1e-7
# numerical: singular values below this share are rounding.
_OPEN_SHARE = 1e-11
# numerical: fits, after which the noise, and with it the weight of a prior, is what it is.
_PRIOR_ROUNDS = 3
# Under which the one camera's lens goes to those who know cameras by name.
CAMERA = "camera"


class _Points(AbstractTarget):
    """Places anywhere in space, under a name that nobody sees.

    Fields
    ------
    centres_mm : (n, 3).
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
    """One camera that sees the points, each to a pixel; the lens's `names` are free.

    The lens is of the widest model that contains the camera's, so that what it lacks is held at 0.
    """
    count = len(points_mm)
    unit = np.broadcast_to(np.eye(2), (count, 2, 2))
    no_lines = np.full((2, 3), np.nan)
    seen = Detection(np.arange(count), uv_px, unit, unit, no_lines, camera.image_size_px)
    pose = camera.pose.aim_at_origin() if model is PoseModel.AIMED else camera.pose
    target = _Points("points", points_mm, np.zeros(count))
    one = SheetCamera(CAMERA, seen, camera.intrinsics, None, pose)
    problem = sheet_problem([one], target, SheetPriors(model, Systematics(), tuning))
    count, _ = problem.parametrization.lens_shape
    lenses = [skew_lens(lens_number(problem, k)) for k in range(count)]
    problem = with_wider_lenses(problem, lenses, [camera.image_size_px] * count)
    return with_lens_parameters_free(problem, names)


def with_lens_parameters_free(problem: Problem, names: Collection[str]) -> Problem:
    """The problem with these of the one lens's parameters free."""
    free = np.array(problem.free)
    free[problem.slices.lens(0)] = [name in names for name in lens_parameter_names(problem)]
    return with_head_free(problem, free)


def fit_without_outliers(problem: Problem) -> Problem:
    """The problem where its fit ends, without points that are not those that they are said to be.

    Raises CalibrationError where it does not.
    """
    (view,) = problem.views
    for _ in range(_CUTS):
        problem, converged = fit_places(problem._replace(views=(view,)))
        pose = Pose(np.asarray(problem.state.cam_from_rig)[0])
        in_front = (problem.target.centres_mm @ pose.rotation[2] + pose.translation_mm[2]) > 0
        if not (converged and in_front[view.used].all()):
            raise CalibrationError(
                f"The fit to {int(view.used.sum())} points did not converge: check that the "
                "places, the pixels and the lens belong together."
            )
        far = np.linalg.norm(errors_px(problem)[0], axis=1)
        # The median of a Rayleigh distribution is 1.18 sigma.
        kept = far <= problem.tuning.problem.gate * np.median(far[view.used]) / 1.18 + 1e-9
        if np.array_equal(kept, view.used):
            break
        view = view._replace(used=kept)
    return problem


def extend_lens(problem: Problem, names: tuple[str, ...]) -> tuple[Problem, tuple[str, ...]]:
    """The fit with as many coefficients, and with a skew, as the points ask for, and the names of
    all that is then free. Each time that which noise alone explains least is freed; a skew that is
    not asked for any more, beside what was freed later, is held again.

    problem : the fit with `names` free.
    """
    every, coefficients = lens_parameter_names(problem), DEFAULT_DISTORTION.coefficient_names
    wider = [coefficients[:count] for count in DEFAULT_DISTORTION.coefficient_counts]
    straight = None
    while True:
        points, asked = score_of_points(problem), []
        for group in (*wider, (SKEW,)):
            columns = [every.index(name) for name in group if name not in names]
            if columns:
                asked.append((*points.rank(points.judge(columns)), group))
        chance, _, best = min(asked, default=(1.0, 0.0, ()))
        if chance * len(asked) > problem.tuning.answer.chance or not asked:
            break
        straight = problem if best == (SKEW,) else straight
        names = tuple(name for name in every if name in {*names, *best})
        problem = _fit_with_free(problem, names)
    if straight is None:
        return problem, names
    fewer = tuple(name for name in names if name != SKEW)
    try:
        held = _fit_with_free(straight, fewer)
    except CalibrationError:  # without a skew the points have no fit
        return problem, names
    points = score_of_points(held)
    is_idle = points.chance(points.judge([every.index(SKEW)])) > problem.tuning.answer.chance
    return (held, fewer) if is_idle else (problem, names)


def _fit_with_free(problem: Problem, names: tuple[str, ...]) -> Problem:
    """The fit of all points with these of the lens's parameters free, from where it stands."""
    used = np.ones(len(problem.views[0].used), dtype=bool)
    problem = problem._replace(views=(problem.views[0]._replace(used=used),))
    return fit_without_outliers(with_lens_parameters_free(problem, names))


def lens_parameter_names(problem: Problem) -> tuple[str, ...]:
    """Of the lens that is fitted: those of the camera's, and of the model that contains it."""
    return problem.state.lenses.parameter_names


def score_of_points(problem: Problem) -> HeldScore:
    """Of every step of the head at a problem's state, for residuals in px; of those that are
    fitted nothing is left."""
    near, (view,) = whiten_views(problem), problem.views
    fitted = np.flatnonzero(problem.free)
    rows = np.flatnonzero(np.repeat(view.used, 2))
    by_head, residual = near.jacobian[0][rows], near.residual[0][rows]
    base, values, _ = np.linalg.svd(by_head[:, fitted], full_matrices=False)
    base = base[:, values > _OPEN_SHARE * values[0]]
    left = by_head - base @ (base.T @ by_head)
    residual = residual - base @ (base.T @ residual)
    squared = float(residual @ residual)
    return HeldScore(
        left=left.T @ left,
        pull=left.T @ residual,
        whole=np.sum(by_head**2, axis=0),
        squared=squared,
        freedom=len(rows) - base.shape[1],
        are_exact=squared < ROUNDING_PX**2 * len(residual),
    )


class FitUnderPrior(NamedTuple):
    """A fit with the lens's uncertain parameters free under their covariance. strain : the largest
    of their errors, of as many sigmas."""

    problem: Problem
    strain: float


def fit_under_prior(
    problem: Problem, names: Collection[str], held: Float[np.ndarray, "q r"]
) -> FitUnderPrior:
    """The fit with `names` free, and the rest of the lens under what was said of it.

    held : change of the lens's parameters for a sigma of each error that is not fitted; what has
        none is exact. The problem's parametrization stays as it is.
    """
    parametrization, (view,) = problem.parametrization, problem.views
    count, size = parametrization.lens_shape
    scale = np.asarray(parametrization.lens_scale)[0]
    mean = np.asarray(lens_number(problem, 0).parameters)
    directions, sizes, _ = np.linalg.svd(held / scale[:, None], full_matrices=False)
    is_open = sizes > _OPEN_SHARE * sizes[0]
    steps = int(is_open.sum())
    factor = scale[:, None] * directions[:, is_open] * sizes[is_open]
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
        # Residuals are in px, whose variance the prior is to be weighed by.
        variance = float(np.sum(errors_px(fitted)[0][view.used] ** 2)) / freedom
        information = np.zeros((count, size, size))
        information[0] = variance * inverse.T @ inverse
        known = with_priors(fitted, lens_mean=means, lens_information=information)
        opened = dataclasses.replace(known.parametrization, lens_basis=basis, free=free)
        fitted, _ = fit_places(known._replace(parametrization=opened))
    errors = inverse @ (np.asarray(lens_number(fitted, 0).parameters) - mean)
    return FitUnderPrior(
        fitted._replace(parametrization=parametrization), float(np.abs(errors).max())
    )
