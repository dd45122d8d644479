"""Joint adjustment of the cameras over one sheet: estimate, covariance, and scatter of
each camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import WhitenedViews, whiten_views
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.problem.robust_fit import (
    fit_points,
    fit_without_wrong_points,
    inliers,
    with_sigma_factors,
)
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors, sheet_problem
from trinoc.calib.problem.solver import LEAST_DAMPING
from trinoc.calib.result.degrees import degrees_by_step, largest_sigmas
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.information import Observability, observability_of_root

# numerical: singular values of a root with columns of length 1 below this share of the largest
# are rounding.
_ROUNDING = 1e-14


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Joint estimate of all cameras over one sheet from their observations and all priors.

    Attributes
    ----------
    cameras : observations of the cameras, in the order of the views.
    priors : priors on sheet, lenses and aims.
    problem : problem at the estimate, with the used points and the factors of their sigmas.
    whitened : whitened residuals of the v views there, and their derivatives by all steps.
    root : (f, f) upper triangular R of the information R^T R of the free steps, with the priors.
        Rigs of many shots form the information itself (`problem.information`), since a root would
        be too large. Here that would lose half of the digits: for the demo's images R has a
        condition number of 5e6, and variances from the inverse of R^T R are wrong by up to 0.8 %.
    reduced_chi_square : (v,) of the points, before their sigmas were enlarged.
    freedom : (v,) degrees of freedom of the same; 0 below 1.
    converged : whether the last fit converged.
    """

    cameras: tuple[SheetCamera, ...]
    priors: SheetPriors
    problem: Problem
    whitened: WhitenedViews
    root: Float[np.ndarray, "f f"]
    reduced_chi_square: Float[np.ndarray, "v"]
    freedom: Float[np.ndarray, "v"]
    converged: bool

    @cached_property
    def free(self) -> np.ndarray:
        """Indices of the free steps of the head, (f,)."""
        return np.flatnonzero(self.problem.free)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "f f"]:
        """Covariance of the free steps, (f, f); 0 along undetermined directions."""
        inverse = _inverse(self.root)
        return inverse @ inverse.T

    @property
    def model(self) -> PoseModel:
        """Estimated parameters of each pose."""
        return self.priors.fitted_model

    @property
    def used(self) -> list[np.ndarray]:
        """Masks of the used circles, (m,) for each camera."""
        return [view.used for view in self.problem.views]

    @property
    def sigma_factors(self) -> Float[np.ndarray, "v"]:
        """Factor of each camera's sigmas, (v,); 1 if its points scatter by their sigmas."""
        return np.asarray(self.problem.sigma_factor)[: len(self.problem.views)]

    def pose(self, view: int) -> Pose:
        """Pose of a camera."""
        return Pose(np.asarray(self.problem.state.cam_from_rig)[view])

    def lens(self, view: int) -> AbstractLens:
        """Estimated lens of a camera."""
        return lens_number(self.problem, self._lens_of(view))

    def distance_mm(self, view: int) -> float:
        """Distance from a camera to the sheet along its axis, mm."""
        return float(self.pose(view).distance_mm)

    def rows(self, view: int) -> np.ndarray:
        """Indices of a camera's pose among the free steps."""
        return self._rows_in(self.problem.slices.camera(view))

    def lens_steps(self, view: int) -> Float[np.ndarray, "r"]:
        """Estimated minus stated lens along each direction of its prior, in sigmas of the prior,
        (r,).
        """
        number = self._lens_of(view)
        change = np.asarray(self.lens(view).parameters) - self.problem.priors.lens_mean[number]
        count = int(np.sum(self.problem.free[self.problem.slices.lens(number)]))
        basis = self.problem.parametrization.lens_basis[number][:, :count]
        steps, *_ = np.linalg.lstsq(basis, change)
        return steps

    def lens_rows(self, view: int) -> np.ndarray:
        """Indices of a camera's lens among the free steps."""
        return self._rows_in(self.problem.slices.lens(self._lens_of(view)))

    def _lens_of(self, view: int) -> int:
        return int(self.problem.parametrization.lens_of_camera[view])

    def _rows_in(self, part: slice) -> np.ndarray:
        return np.flatnonzero((self.free >= part.start) & (self.free < part.stop))

    def pose_root(self, view: int) -> Float[np.ndarray, "p p"]:
        """R of the information R^T R of one camera's pose, with all other unknowns eliminated, (p,
        p).
        """
        rows = self.rows(view)
        others = np.delete(np.arange(len(self.root)), rows)
        last = np.concatenate([others, rows])
        return _triangle(self.root[:, last])[len(others) :, len(others) :]

    def observability(self, view: int, sigma_factor: float = 1.0) -> Observability:
        """Parameters of one camera's pose that are determined, with all other unknowns eliminated.

        sigma_factor : divisor of the sigmas of all observations.
        """
        largest = largest_sigmas(self.model, self.distance_mm(view))
        root = sigma_factor * self.pose_root(view)
        return observability_of_root(root, self.degrees_by_step(view), largest)

    def covariance_with(self, weights: Float[np.ndarray, "f"]) -> Float[np.ndarray, "f f"]:
        """Covariance with one more prior on each free step, (f, f). weights : inverse sigmas of the
        priors.
        """
        inverse = _inverse(_triangle(np.concatenate([self.root, np.diag(weights)])))
        return inverse @ inverse.T

    def parameters(self, view: int) -> Float[np.ndarray, "p"]:
        """Pan, tilt and swing in rad, distance in mm, and the aim in mm if it is free, (p,)."""
        return np.asarray(self.pose(view).parameters)[: self.model.size]

    def degrees_by_step(self, view: int) -> Float[np.ndarray, "p p"]:
        """Derivative of `parameters`, in degrees and mm, by a step of the pose, (p, p)."""
        return degrees_by_step(self.pose(view), self.problem.parametrization.unit_mm, self.model)


def adjust(
    cameras: Sequence[SheetCamera],
    target: AbstractTarget,
    priors: SheetPriors,
    start: Adjustment | None = None,
    first_damping: float | None = LEAST_DAMPING,
) -> Adjustment:
    """Adjust all cameras together, without outliers.

    Parameters
    ----------
    start : adjustment of the same cameras with other observations. The new one continues from its
        estimate and omits its outliers: outliers are determined only once.
    first_damping : of the first fit. Circles give a start so near that undamped steps converge.

    Notes
    -----
    If the points of a camera scatter more than their sigmas, these are enlarged in a second fit.
    """
    problem = sheet_problem(cameras, target, priors)
    if start is not None:
        pairs = zip(problem.views, start.problem.views, strict=True)
        views = tuple(view._replace(used=earlier.used) for view, earlier in pairs)
        problem = problem._replace(views=views, state=start.problem.state)
    problem, converged = fit_points(problem, first_damping=first_damping)
    whitened = whiten_views(problem)
    if start is None:
        errors = whitened.residual.reshape(len(cameras), -1, 2)
        suspects = [
            k
            for k, camera in enumerate(cameras)
            if camera.grey_level_points is None
            and not inliers(errors[k], 1.0, problem.tuning.problem.gate).all()
        ]
        if suspects:
            problem, converged = fit_without_wrong_points(problem, suspects)
            whitened = whiten_views(problem)
    root = _root(problem, whitened)
    squared, freedom = _chi_squares(problem, whitened, root)
    reduced = np.where(freedom > 0, squared / np.maximum(freedom, 1.0), np.nan)
    enlarged = with_sigma_factors(problem, squared, freedom)
    if (enlarged.sigma_factor > 1).any():
        problem, converged = fit_points(enlarged, first_damping=LEAST_DAMPING)
        whitened = whiten_views(problem)
        root = _root(problem, whitened)
    return Adjustment(tuple(cameras), priors, problem, whitened, root, reduced, freedom, converged)


def _root(problem: Problem, whitened: WhitenedViews) -> Float[np.ndarray, "f f"]:
    """R of the information R^T R of the free steps, with the priors, (f, f)."""
    free = np.flatnonzero(problem.free)
    rows = whitened.jacobian[..., free].reshape(-1, len(free))
    priors = np.diag(prior_weights(problem)[free])
    return _triangle(np.concatenate([rows, priors]))


def prior_weights(problem: Problem) -> Float[np.ndarray, "h"]:
    """Inverse prior sigma of each step of the head, (h,); 0 without a prior."""
    slices, priors, scale = problem.slices, problem.priors, problem.parametrization.sheet_scale
    weights = np.zeros(len(problem.free))
    # A step of a lens or of the sheet is a standard deviation of its prior.
    weights[slices.lenses] = 1.0
    weights[slices.sheets] = np.diag(priors.sheet_information) ** 0.5 * scale
    for camera, information in enumerate(priors.aim_information):
        aim = slices.camera(camera)
        aim_steps = slice(aim.start + 4, aim.stop)
        weights[aim_steps] = np.sqrt(information) * problem.parametrization.unit_mm
    return weights * problem.free


def _triangle(rows: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "k k"]:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _inverse(root: Float[np.ndarray, "f f"]) -> Float[np.ndarray, "f f"]:
    """Inverse of R, zero along undetermined directions."""
    scale = np.maximum(np.linalg.norm(root, axis=0), 1e-300)
    left_vectors, values, right_vectors = np.linalg.svd(root / scale)
    is_determined = values > _ROUNDING * values.max(initial=0.0)
    return (
        (right_vectors[is_determined].T / values[is_determined])
        @ left_vectors[:, is_determined].T
        / scale[:, None]
    )


def _chi_squares(
    problem: Problem, whitened: WhitenedViews, root: Float[np.ndarray, "f f"]
) -> tuple[Float[np.ndarray, "v"], Float[np.ndarray, "v"]]:
    """Chi-square of each camera and its degrees of freedom; values below 1 are set to 0."""
    free = np.flatnonzero(problem.free)
    fitted = np.sum((whitened.jacobian[..., free] @ _inverse(root)) ** 2, axis=(1, 2))
    freedom = np.array([view.coordinate_count for view in problem.views]) - fitted
    return np.sum(whitened.residual**2, axis=1), np.where(freedom >= 1, freedom, 0.0)
