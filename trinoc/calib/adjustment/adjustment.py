"""Joint adjustment of the cameras over one sheet, with its covariance."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import WhitenedViews, whiten_views
from trinoc.calib.problem.problem import Problem, lens_of_index
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
    """Joint least-squares estimate of all cameras that observe one sheet, with priors of sheet,
    lenses and aims.

    The f estimated parameters are those of lenses, camera poses, and print and bend of the sheet.
    They are local coordinates: small changes at the estimate.

    Attributes
    ----------
    cameras : observations of each of v cameras. A camera is addressed by its index `view` in this
        tuple.
    priors : priors of sheet, lenses and aims.
    problem : problem at the solution. It contains the mask of used circles, and the factors by
        which the point sigmas were multiplied.
    whitened : whitened residuals at the solution and their Jacobian.
    root : (f, f) upper triangular R of the information R^T R of the estimated parameters, priors
        included. It is computed directly by a QR decomposition of the Jacobian, because R^T R would
        lose half of the digits.
    reduced_chi_square : (v,) chi-square of each camera's points divided by `freedom`, before the
        point sigmas were enlarged; NaN if `freedom` is 0.
    freedom : (v,) degrees of freedom of each camera's points; 0 if below 1.
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
        """Indices, (f,), of the estimated parameters among all parameters of the problem."""
        return np.flatnonzero(self.problem.free)

    @cached_property
    def covariance(self) -> Float[np.ndarray, "f f"]:
        """Covariance, (f, f), of the estimated parameters; 0 in undetermined directions."""
        inverse = _inverse(self.root)
        return inverse @ inverse.T

    @property
    def model(self) -> PoseModel:
        """Pose model: the parameters of each pose that are estimated."""
        return self.priors.fitted_model

    @property
    def used(self) -> list[np.ndarray]:
        """Mask, (m,), of the used circles of each camera; outliers are not used."""
        return [view.used for view in self.problem.views]

    @property
    def sigma_factors(self) -> Float[np.ndarray, "v"]:
        """Factor, (v,), by which the point sigmas of each camera were multiplied; 1 if the sigmas
        are right.
        """
        return np.asarray(self.problem.sigma_factor)[: len(self.problem.views)]

    def pose(self, view: int) -> Pose:
        """Estimated pose of a camera, cam_from_world."""
        return Pose(np.asarray(self.problem.state.cam_from_rig)[view])

    def lens(self, view: int) -> AbstractLens:
        """Estimated lens of a camera."""
        return lens_of_index(self.problem, self._lens_of(view))

    def distance_mm(self, view: int) -> float:
        """Distance from the camera's centre of projection to the sheet along the
        optical axis, mm.
        """
        return float(self.pose(view).distance_mm)

    def rows(self, view: int) -> np.ndarray:
        """Indices of a camera's pose parameters among the f estimated parameters."""
        return self._rows_in(self.problem.slices.camera(view))

    def lens_steps(self, view: int) -> Float[np.ndarray, "r"]:
        """Difference between the estimated and the given lens of a camera, (r,), in sigmas of its
        prior.

        The r components are those along the columns of the factor L of the prior covariance L L^T.
        """
        lens_index = self._lens_of(view)
        change = np.asarray(self.lens(view).parameters) - self.problem.priors.lens_mean[lens_index]
        count = int(np.sum(self.problem.free[self.problem.slices.lens(lens_index)]))
        basis = self.problem.parametrization.lens_basis[lens_index][:, :count]
        steps, *_ = np.linalg.lstsq(basis, change)
        return steps

    def lens_rows(self, view: int) -> np.ndarray:
        """Indices of a camera's lens parameters among the f estimated parameters."""
        return self._rows_in(self.problem.slices.lens(self._lens_of(view)))

    def _lens_of(self, view: int) -> int:
        return int(self.problem.parametrization.lens_of_camera[view])

    def _rows_in(self, part: slice) -> np.ndarray:
        return np.flatnonzero((self.free >= part.start) & (self.free < part.stop))

    def pose_root(self, view: int) -> Float[np.ndarray, "p p"]:
        """Upper triangular R, (p, p), of the information R^T R of one camera's pose.

        All other estimated parameters are eliminated.
        """
        rows = self.rows(view)
        others = np.delete(np.arange(len(self.root)), rows)
        last = np.concatenate([others, rows])
        return _triangle(self.root[:, last])[len(others) :, len(others) :]

    def observability(self, view: int, sigma_factor: float = 1.0) -> Observability:
        """Rank and covariance of the pose parameters of one camera, with all other parameters
        eliminated.

        sigma_factor : the sigmas of all observations are divided by this number first.
        """
        largest = largest_sigmas(self.model, self.distance_mm(view))
        root = sigma_factor * self.pose_root(view)
        return observability_of_root(root, self.degrees_by_step(view), largest)

    def covariance_with(self, weights: Float[np.ndarray, "f"]) -> Float[np.ndarray, "f f"]:
        """Covariance, (f, f), that would result if each estimated parameter had an additional
        prior.

        weights : (f,) inverse sigma of each additional prior; 0 for none.
        """
        inverse = _inverse(_triangle(np.concatenate([self.root, np.diag(weights)])))
        return inverse @ inverse.T

    def parameters(self, view: int) -> Float[np.ndarray, "p"]:
        """Pose parameters of one camera, (p,): pan, tilt, swing in rad, distance in mm, and the aim
        in mm.

        The aim is missing if it is fixed.
        """
        return np.asarray(self.pose(view).parameters)[: self.model.size]

    def degrees_by_step(self, view: int) -> Float[np.ndarray, "p p"]:
        """Jacobian, (p, p), of the pose parameters in degrees and mm with respect to local
        coordinates.
        """
        return degrees_by_step(self.pose(view), self.problem.parametrization.unit_mm, self.model)


def adjust(
    cameras: Sequence[SheetCamera],
    target: AbstractTarget,
    priors: SheetPriors,
    start: Adjustment | None = None,
    first_damping: float | None = LEAST_DAMPING,
) -> Adjustment:
    """Fit all cameras that observe one sheet together, without outlier circles.

    If the residuals of a camera are larger than its point sigmas, these sigmas are enlarged and all
    cameras are fitted again.

    Parameters
    ----------
    cameras : observations of each camera.
    target : the sheet.
    priors : priors of sheet, lenses and aims.
    start : earlier adjustment of the same cameras with other observations. The new fit starts from
        its estimate and excludes the same outliers. Default: the fit starts from the initial poses
        of the cameras, and outliers are searched.
    first_damping : damping of the first step of the first fit. Initial poses from circles are so
        accurate that undamped steps converge.
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
    """Upper triangular R, (f, f), of the information R^T R of the estimated parameters.

    The information includes the priors.
    """
    free = np.flatnonzero(problem.free)
    rows = whitened.jacobian[..., free].reshape(-1, len(free))
    priors = np.diag(prior_weights(problem)[free])
    return _triangle(np.concatenate([rows, priors]))


def prior_weights(problem: Problem) -> Float[np.ndarray, "h"]:
    """Inverse prior sigma of each parameter in local coordinates, (h,); 0 without a prior."""
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
    """Pseudo-inverse of R, which is 0 in undetermined directions."""
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
    """Chi-square of each camera and its degrees of freedom, (v,) each.

    Degrees of freedom below 1 are set to 0.
    """
    free = np.flatnonzero(problem.free)
    fitted = np.sum((whitened.jacobian[..., free] @ _inverse(root)) ** 2, axis=(1, 2))
    freedom = np.array([view.coordinate_count for view in problem.views]) - fitted
    return np.sum(whitened.residual**2, axis=1), np.where(freedom >= 1, freedom, 0.0)
