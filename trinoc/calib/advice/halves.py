"""Fits to two halves of the shots: how far each misses the other's shots, and whether both agree as
well as their covariances claim."""

from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.field_difference import field_differences
from trinoc.calib.problem.information import Information, compute_information
from trinoc.calib.problem.outcome import enlarge_covariance
from trinoc.calib.problem.problem import Problem, lens_number, with_head_held, with_sheet_held
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.result.halves import CrossValidation, HalvesCheck
from trinoc.calib.targets.board_set import board_prefixes
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit

# numerical: a half of one shot has nothing left to compare.
FEWEST_SHOTS = 4
# numerical: of the largest variance: below, a prior that both halves share has left no difference.
_LEAST_SHARE = 1e-10


class HalfFit(NamedTuple):
    """Fit to one half of the shots, and the shots of the other half."""

    problem: Problem
    converged: bool
    held_out: frozenset[int]

    def full_information(self) -> Information | None:
        """Information of this half; None where it does not determine all that is free."""
        information = compute_information(self.problem)
        full = information.observability.rank == len(information.free)
        return information if full else None


def cross_validate(problem: Problem, cameras: tuple[str, ...]) -> CrossValidation | None:
    """Every second shot from the others, then the other way round.

    Lenses, cameras and board are fitted anew without the shots held out; which places were located
    wrongly is known from all. None where a half does not determine the rig.
    """
    own: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    across: dict[str, list[np.ndarray]] = {name: [] for name in cameras}
    if len(list_used_shots(problem)) < FEWEST_SHOTS:
        return None
    for half in fit_halves(problem):
        if half.full_information() is None:
            return None
        # An image that stands for itself has a pose of its own.
        views = tuple(view.without_motion() for view in problem.views)
        known = with_head_held(half.problem._replace(views=views))
        for source in range(len(cameras)):
            seen = {v.shot for v in problem.views if v.camera == source and v.used.any()}
            seen &= half.held_out
            placed, _ = fit_places(keep_shots(known, seen, {source}))
            for view, errors in zip(problem.views, errors_px(placed), strict=True):
                if view.shot in seen:
                    into = own if view.camera == source else across
                    into[cameras[view.camera]].append(errors[view.kept])
    return CrossValidation(len(list_used_shots(problem)), _rms_px(own), _rms_px(across))


def fit_halves(problem: Problem) -> Iterator[HalfFit]:
    """The problem fitted to every second shot; then to the others."""
    shots = list_used_shots(problem)
    for remainder in (0, 1):
        end, converged = fit_places(keep_shots(problem, shots[remainder::2]))
        yield HalfFit(end, converged, frozenset(shots[1 - remainder :: 2]))


def list_used_shots(problem: Problem) -> list[int]:
    """The shots of which some place takes part."""
    return sorted({view.shot for view in problem.views if view.used.any()})


def keep_shots(
    problem: Problem, shots: Collection[int], cameras: Collection[int] | None = None
) -> Problem:
    """The problem with the places of these shots, and these cameras, alone."""
    views = tuple(
        view
        if view.shot in shots and (cameras is None or view.camera in cameras)
        else view._replace(used=np.zeros_like(view.used))
        for view in problem.views
    )
    return problem._replace(views=views)


def _rms_px(errors: Mapping[str, list[np.ndarray]]) -> dict[str, float]:
    return {
        name: float(np.sqrt(np.mean(np.sum(np.concatenate(own) ** 2, axis=1))))
        for name, own in errors.items()
        if own
    }


def compare_halves(
    problem: Problem, cameras: tuple[str, ...], variance_factor: float
) -> HalvesCheck | None:
    """Compare every second shot with the others; None where a half does not determine the rig.

    The board is taken as the whole fit found it, since both halves share it; `variance_factor` is
    that by which its covariance was enlarged.
    """
    if len(list_used_shots(problem)) < FEWEST_SHOTS:
        return None
    problem = with_sheet_held(problem)
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
    each = np.abs(difference) / sigma
    worst = int(np.argmax(each))
    names = head_names(problem, cameras)
    column = int(np.flatnonzero(problem.free)[worst])
    over_field = field_differences(problem, states, covariance, cameras)
    return HalvesCheck(ratio, names[column], float(each[worst]), directions, over_field)


def covariance_of_difference(
    first: Float[np.ndarray, "f f"],
    second: Float[np.ndarray, "f f"],
    prior: Float[np.ndarray, "f f"],
    variance_factor: float,
) -> Float[np.ndarray, "f f"]:
    """Of two fits to other data, of these covariances, that one prior of information P draws both.

    Each has noise of its own, of covariance f C_i (P^-1 - C_i) P; the prior's error, which both
    have in the shares C_i P, is left in (C_1 - C_2) P (C_1 - C_2).
    """
    shared = first @ prior @ second
    own = [enlarge_covariance(each, variance_factor, prior) for each in (first, second)]
    return own[0] + own[1] - shared - shared.T


def _squared_mahalanobis(
    difference: Float[np.ndarray, "f"], covariance: Float[np.ndarray, "f f"]
) -> tuple[int, float]:
    """In how many directions the halves can differ at all, and by how many squared sigmas."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    can = values > _LEAST_SHARE * values[-1]
    along = vectors[:, can].T @ (difference / scale)
    return int(can.sum()), float(np.sum(along**2 / values[can]))


def find_steps_to_half(problem: Problem, end: Problem) -> np.ndarray:
    """The step of the head that takes the whole fit to that of a half."""
    parametrization, lenses = problem.parametrization, range(problem.parametrization.lens_shape[0])
    before, after = (
        np.stack([lens_number(each, k).parameters for k in lenses]) for each in (problem, end)
    )
    by_lens = (after - before) / np.asarray(parametrization.lens_scale)
    start, stop = (
        np.concatenate([each.state.cam_from_rig, each.state.set_from_board])
        for each in (problem, end)
    )
    by_pose = np.asarray(_motions(start, stop)) / np.repeat(
        [1.0, float(parametrization.unit_mm)], 3
    )
    of_rest = np.zeros(len(problem.free) - problem.slices.sheets.start)
    return np.concatenate([by_lens.ravel(), by_pose.ravel(), of_rest])


@kept_jit
def _motions(
    before: Float[ArrayLike, "n 3 4"], after: Float[ArrayLike, "n 3 4"]
) -> Float[ArrayLike, "n 6"]:
    """The rotation about each camera's axes, and the displacement of its centre."""

    def motion(start: ArrayLike, end: ArrayLike) -> ArrayLike:
        return Pose(end).model_parameters(PoseModel.RIGID, Pose(start))

    return jax.vmap(motion)(before, after)


def head_names(problem: Problem, cameras: tuple[str, ...]) -> list[str]:
    """Names of the steps of the head, the places of the board left out."""
    of_lens = problem.state.lenses.parameter_names
    owner = [
        cameras[int(np.flatnonzero(problem.parametrization.lens_of_camera == k)[0])]
        for k in range(problem.parametrization.lens_shape[0])
    ]
    pose = ("turn_x", "turn_y", "turn_z", "x", "y", "z")
    names = [f"{name}.{each}" for name in owner for each in of_lens]
    names += [f"{name}.{each}" for name in cameras for each in pose]
    prefixes = board_prefixes(problem.target)
    if len(problem.state.set_from_board):
        names += [f"{prefix}{each}" for prefix in prefixes for each in pose]
    sheet = [name.removesuffix("_mm") for name in problem.parametrization.sheet_model.names]
    return [*names, *(f"{prefix}{each}" for prefix in prefixes for each in sheet)]
