"""Fits to two halves of the shots: residuals in the other half, and difference in sigmas."""

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.field_difference import field_differences
from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.outcome import enlarge_covariance
from trinoc.calib.problem.problem import (
    Problem,
    lens_of_index,
    with_fixed_board_shape,
    with_only_boards_free,
)
from trinoc.calib.problem.robust_fit import errors_px, fit_points
from trinoc.calib.result.halves import CrossValidation, HalvesCheck
from trinoc.calib.targets.board_set import board_prefixes
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: halves of one shot cannot be compared.
FEWEST_SHOTS = 4
# numerical: directions with a smaller share of the largest variance are fixed by a common prior.
_LEAST_SHARE = 1e-10


class HalfFit(NamedTuple):
    """Fit to one half of the shots.

    Attributes
    ----------
    problem : problem at the solution; only the shots of this half are used.
    converged : whether the fit converged.
    held_out : indices of the shots of the other half.
    """

    problem: Problem
    converged: bool
    held_out: frozenset[int]

    def full_information(self) -> Information | None:
        """Information of the shots of this half. None if they do not determine all estimated
        parameters.
        """
        information = compute_information(self.problem)
        full = information.observability.rank == len(information.free)
        return information if full else None


def cross_validate(problem: Problem, cameras: tuple[str, ...]) -> CrossValidation | None:
    """Compute residuals in shots that were not used to fit lenses and cameras (two-fold
    cross-validation).

    The rig is fitted to every second shot, and then to the remaining shots. In the held-out shots
    only the board pose is fitted, to the image of one camera. Outliers are those of the fit to all
    shots. Returns None if one half does not determine the rig.
    """
    same_camera: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    other_camera: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    if len(list_used_shots(problem)) < FEWEST_SHOTS:
        return None
    for half in fit_halves(problem):
        if half.full_information() is None:
            return None
        # An image with motion errors gets a pose of its own.
        views = tuple(view.without_motion() for view in problem.views)
        fixed = with_only_boards_free(half.problem._replace(views=views))
        for source in range(len(cameras)):
            source_shots = {v.shot for v in problem.views if v.camera == source and v.used.any()}
            source_shots &= half.held_out
            fitted, _ = fit_points(keep_shots(fixed, source_shots, {source}))
            for view, errors in zip(problem.views, errors_px(fitted), strict=True):
                if view.shot in source_shots:
                    errors_of_camera = same_camera if view.camera == source else other_camera
                    errors_of_camera[cameras[view.camera]].append(errors[view.rows_used])
    return CrossValidation(
        len(list_used_shots(problem)), _rms_px(same_camera), _rms_px(other_camera)
    )


def fit_halves(problem: Problem) -> Iterator[HalfFit]:
    """Yield the fit to every second shot, then the fit to the remaining shots."""
    shots = list_used_shots(problem)
    for remainder in (0, 1):
        end, converged = fit_points(keep_shots(problem, shots[remainder::2]))
        yield HalfFit(end, converged, frozenset(shots[1 - remainder :: 2]))


def list_used_shots(problem: Problem) -> list[int]:
    """Indices of the shots that have at least one used board point."""
    return sorted({view.shot for view in problem.views if view.used.any()})


def keep_shots(
    problem: Problem, shots: Collection[int], cameras: Collection[int] | None = None
) -> Problem:
    """Problem in which only the observations of some shots, and optionally of some cameras, are
    used.
    """
    views = tuple(
        view
        if view.shot in shots and (cameras is None or view.camera in cameras)
        else view._replace(used=np.zeros_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


def _rms_px(errors: Mapping[str, list[np.ndarray]]) -> dict[str, float]:
    return {
        name: float(np.sqrt(np.mean(np.sum(np.concatenate(lengths) ** 2, axis=1))))
        for name, lengths in errors.items()
        if lengths
    }


def compare_halves(
    problem: Problem, cameras: tuple[str, ...], variance_factor: float
) -> HalvesCheck | None:
    """Compare the rigs fitted to two halves of the shots, in sigmas and in pixels.

    Returns None if one half does not determine the rig. The board shape is fixed at that of the fit
    to all shots, since both halves show the same board.

    variance_factor : factor by which the noise variance of the fit to all shots was multiplied.
    """
    if len(list_used_shots(problem)) < FEWEST_SHOTS:
        return None
    problem = with_fixed_board_shape(problem)
    ends, states, prior = [], [], np.zeros(())
    for half in fit_halves(problem):
        information = half.full_information()
        if information is None or not half.converged:
            return None
        prior = information.prior
        step = find_steps_to_half(problem, half.problem)[information.free]
        ends.append((step, information.observability.covariance))
        states.append(half.problem.state)
    (first, first_covariance), (second, second_covariance) = ends
    covariance = covariance_of_difference(
        first_covariance, second_covariance, prior, variance_factor
    )
    difference = first - second
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    directions, square = _squared_mahalanobis(difference, covariance)
    ratio = float(np.sqrt(square / directions))
    normalised = np.abs(difference) / sigma
    worst = int(np.argmax(normalised))
    names = shared_parameter_names(problem, cameras)
    column = int(np.flatnonzero(problem.free)[worst])
    over_field = field_differences(problem, states, covariance, cameras)
    return HalvesCheck(ratio, names[column], float(normalised[worst]), directions, over_field)


def covariance_of_difference(
    first: Float[np.ndarray, "f f"],
    second: Float[np.ndarray, "f f"],
    prior: Float[np.ndarray, "f f"],
    variance_factor: float,
) -> Float[np.ndarray, "f f"]:
    """Covariance, (f, f), of the difference of two estimates from different data with one common
    prior.

    With noise variance factor s, estimate i has an independent noise covariance of s C_i (P^-1 -
    C_i) P. The error of the common prior adds (C_1 - C_2) P (C_1 - C_2).

    first, second : covariances C_1 and C_2 of the estimates for a factor of 1.
    prior : information P of the prior.
    variance_factor : s.
    """
    shared = first @ prior @ second
    enlarged = [
        enlarge_covariance(covariance, variance_factor, prior) for covariance in (first, second)
    ]
    return enlarged[0] + enlarged[1] - shared - shared.T


def _squared_mahalanobis(
    difference: Float[np.ndarray, "f"], covariance: Float[np.ndarray, "f f"]
) -> tuple[int, float]:
    """Number of directions in which the rigs of two halves can differ, and squared Mahalanobis
    distance between the rigs in these directions.

    Directions that a common prior fixes are omitted.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    is_free = values > _LEAST_SHARE * values[-1]
    along = vectors[:, is_free].T @ (difference / scale)
    return int(is_free.sum()), float(np.sum(along**2 / values[is_free]))


def find_steps_to_half(problem: Problem, end: Problem) -> np.ndarray:
    """Difference between two solutions in local coordinates, (h,): `end` minus `problem`.

    It contains the changes of lenses, camera poses, and board poses in their set. The entries of
    the board shape are 0.
    """
    parametrization, lenses = problem.parametrization, range(problem.parametrization.lens_shape[0])
    whole_lenses, half_lenses = (
        np.stack([lens_of_index(fitted, k).parameters for k in lenses]) for fitted in (problem, end)
    )
    by_lens = (half_lenses - whole_lenses) / np.asarray(parametrization.lens_scale)
    start, stop = (
        np.concatenate([fitted.state.cam_from_rig, fitted.state.set_from_board])
        for fitted in (problem, end)
    )
    by_pose = np.asarray(_motions(start, stop)) / np.repeat(
        [1.0, float(parametrization.unit_mm)], 3
    )
    other_steps = np.zeros(len(problem.free) - problem.slices.sheets.start)
    return np.concatenate([by_lens.ravel(), by_pose.ravel(), other_steps])


@kept_jit
def _motions(
    before: Float[ArrayLike, "n 3 4"], after: Float[ArrayLike, "n 3 4"]
) -> Float[ArrayLike, "n 6"]:
    """Rotation vector about the axes of each camera, rad, and displacement of its centre, mm, (n,
    6).

    before, after : two poses of each of n cameras.
    """

    def motion(start: ArrayLike, end: ArrayLike) -> ArrayLike:
        return Pose(end).model_parameters(PoseModel.RIGID, Pose(start))

    return jax.vmap(motion)(before, after)


def shared_parameter_names(problem: Problem, cameras: tuple[str, ...]) -> list[str]:
    """Names of all parameters that the shots have in common: lenses, camera poses, relative poses
    of boards that are fixed to each other, and print and bend of the boards.

    Displacements of single board points are omitted.
    """
    lens_parameters = problem.state.lenses.parameter_names
    lens_cameras = [
        cameras[int(np.flatnonzero(problem.parametrization.lens_of_camera == k)[0])]
        for k in range(problem.parametrization.lens_shape[0])
    ]
    pose = ("turn_x", "turn_y", "turn_z", "x", "y", "z")
    names = [f"{name}.{parameter}" for name in lens_cameras for parameter in lens_parameters]
    names += [f"{name}.{parameter}" for name in cameras for parameter in pose]
    prefixes = board_prefixes(problem.target)
    if len(problem.state.set_from_board):
        names += [f"{prefix}{parameter}" for prefix in prefixes for parameter in pose]
    sheet = [name.removesuffix("_mm") for name in problem.parametrization.sheet_model.names]
    return [*names, *(f"{prefix}{parameter}" for prefix in prefixes for parameter in sheet)]
