"""The problem of one camera that sees points, and the lens that they ask for."""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.problem import Problem, lens_number, with_wider_lenses
from trinoc.calib.problem.rao_test import RaoTest, judge_pull
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.problem.sheet_problem import SheetCamera, sheet_problem
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING
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
OPEN_SHARE = 1e-11
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
    problem = sheet_problem([one], target, Systematics(), model, aim_sigma_mm=0.0)
    count, _ = problem.chart.lens_shape
    lenses = [skew_lens(lens_number(problem, k)) for k in range(count)]
    problem = with_wider_lenses(problem, lenses, [camera.image_size_px] * count)
    return with_lens_parameters_free(problem, names)


def with_lens_parameters_free(problem: Problem, names: Collection[str]) -> Problem:
    """The problem with these of the one lens's parameters free."""
    free = np.array(problem.chart.free)
    free[: problem.chart.lens_shape[1]] = [name in names for name in lens_parameter_names(problem)]
    return problem._replace(chart=eqx.tree_at(lambda c: c.free, problem.chart, free))


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
        kept = far <= TUNING.problem.gate * np.median(far[view.used]) / 1.18 + 1e-9
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
        points, asked = PointResiduals.of(problem), []
        for group in (*wider, (SKEW,)):
            columns = [every.index(name) for name in group if name not in names]
            if columns:
                asked.append((*points.rank(points.judge(columns)), group))
        chance, _, best = min(asked, default=(1.0, 0.0, ()))
        if chance * len(asked) > TUNING.answer.chance or not asked:
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
    points = PointResiduals.of(held)
    is_idle = points.chance(points.judge([every.index(SKEW)])) > TUNING.answer.chance
    return (held, fewer) if is_idle else (problem, names)


def _fit_with_free(problem: Problem, names: tuple[str, ...]) -> Problem:
    """The fit of all points with these of the lens's parameters free, from where it stands."""
    used = np.ones(len(problem.views[0].used), dtype=bool)
    problem = problem._replace(views=(problem.views[0]._replace(used=used),))
    return fit_without_outliers(with_lens_parameters_free(problem, names))


def lens_parameter_names(problem: Problem) -> tuple[str, ...]:
    """Of the lens that is fitted: those of the camera's, and of the model that contains it."""
    return problem.state.lenses.parameter_names


class PointResiduals(NamedTuple):
    """The residuals at the end of a fit, and what of each column is left beside what was fitted.

    Fields
    ------
    by_head : (m, h) derivatives of the residuals in px by every step of the head.
    left : (m, h) the same, without what a change of what is fitted explains.
    residual : (m,) in px, likewise.
    freedom : of the residuals.
    """

    by_head: Float[np.ndarray, "m h"]
    left: Float[np.ndarray, "m h"]
    residual: Float[np.ndarray, "m"]
    freedom: int

    @classmethod
    def of(cls, problem: Problem) -> "PointResiduals":
        """At a problem's state."""
        near, (view,) = whiten_views(problem), problem.views
        fitted = np.flatnonzero(problem.chart.free)
        rows = np.flatnonzero(np.repeat(view.used, 2))
        by_head, residual = near.jacobian[0][rows], near.residual[0][rows]
        base, values, _ = np.linalg.svd(by_head[:, fitted], full_matrices=False)
        base = base[:, values > OPEN_SHARE * values[0]]
        left = by_head - base @ (base.T @ by_head)
        return cls(by_head, left, residual - base @ (base.T @ residual), len(rows) - base.shape[1])

    def judge(self, columns: Sequence[int]) -> RaoTest:
        """The score test of some columns."""
        left, whole = self.left[:, columns], np.sum(self.by_head[:, columns] ** 2, axis=0)
        return judge_pull(left.T @ left, left.T @ self.residual, whole)

    def chance(self, test: RaoTest) -> float:
        """By noise as the residuals show it. What rounding leaves of exact points asks for
        nothing."""
        squared = float(self.residual @ self.residual)
        if squared < ROUNDING_PX**2 * len(self.residual):
            return 1.0
        return test.chance_beside(squared, self.freedom)

    def noise_variance(self, test: RaoTest) -> float:
        """In px^2, were what was tested free."""
        return test.noise_variance(float(self.residual @ self.residual), self.freedom)

    def rank(self, test: RaoTest) -> tuple[float, float]:
        """The less, the more is explained: the chance, and where that is too small for floating
        point, less what is explained in each direction."""
        return self.chance(test), -test.chi_square / max(test.freedom, 1)
