"""Selection of the next shot: the one that reduces the largest error of lenses and rig most."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.foreseen_shots import (
    Candidate,
    ForeseenShot,
    candidate_shots,
    foresee_shots,
)
from trinoc.calib.advice.halves import shared_parameter_names
from trinoc.calib.problem.information import Information
from trinoc.calib.problem.problem import Problem
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.errors import InputError, check_kind
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import in_float64


class NextShot(NamedTuple):
    """The shot to take next, and its predicted effect.

    Attributes
    ----------
    cameras : names of the cameras that would see the board.
    instruction : text that describes how to hold the board.
    world_from_board : (3, 4) pose of the board, mm.
    parameter : name of the lens parameter whose sigma would shrink most; None if all lenses are
        fixed.
    error_now_px : present prediction error in the worst candidate shot. The prediction error is the
        root mean square pixel error of the shot's board points that errors of lenses and cameras
        cause, after the board pose was fitted to these points.
    error_then_px : `error_now_px` after this shot was added.
    sigma_now, sigma_then : standard deviations of the lens parameters, by name, before and after
        the shot; infinite if undetermined.
    """

    cameras: tuple[str, ...]
    instruction: str
    world_from_board: Float[np.ndarray, "3 4"]
    parameter: str | None
    error_now_px: float
    error_then_px: float
    sigma_now: Mapping[str, float]
    sigma_then: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """Sentence for the user with the instruction and the predicted effect."""
        name = self.parameter
        if name is not None and not np.isfinite(self.sigma_now[name]):
            sigma = self.sigma_then[name]
            return (
                f"Next, {self.instruction}: this shot would determine {name} with a sigma of "
                f"{sigma:.2g}."
            )
        share = 100.0 * (1.0 - self.error_then_px / self.error_now_px)
        sentence = (
            f"Next, {self.instruction}: this shot would reduce the largest error of lenses and "
            f"cameras by {max(share, 0.0):.0f} %"
        )
        if name is None:
            return f"{sentence}."
        now, then = self.sigma_now[name], self.sigma_then[name]
        return (
            f"{sentence}; most of all, the sigma of {name} would fall from {now:.2g} to {then:.2g}."
        )


class _BestShot(NamedTuple):
    """The best candidate, and its predicted effect.

    Attributes
    ----------
    shot : the candidate.
    covariance : (f, f) covariance of lenses, cameras and board after the shot.
    error_now_px, error_then_px : prediction error in the worst candidate, before and after the
        shot, as in `NextShot`.
    """

    shot: ForeseenShot
    covariance: Float[np.ndarray, "f f"]
    error_now_px: float
    error_then_px: float


@in_float64
def next_shot(result: CalibrationResult) -> NextShot | None:
    """Return the shot that would reduce the largest error of lenses and cameras most.

    Candidates are board poses in front of each camera: nine positions in its image, several
    distances, square to the camera or tilted in four directions.

    Parameters
    ----------
    result : result of `calibrate_rig` or `calibrate_intrinsics`. Its parameters need not be
        determined.

    Returns
    -------
    The shot. None if no camera would detect the board in any candidate.

    Raises
    ------
    InputError : the result comes from another calibration, or its fit did not converge.
    """
    check_kind(result, CalibrationResult, "result", "what calibrate_rig returns")
    end = result.solved_problem
    if end is None:
        reason = "The result is not from many shots."
        if result.views:
            reason = result.overall_status.value
        raise InputError(f"A shot cannot be added to this result: {reason}")
    problem = end.problem
    best = _best_shot(problem, end.covariance, end.variance_factor)
    if best is None:
        return None
    is_one, candidate = len(result.cameras) == 1, best.shot.candidate
    names = tuple(result.cameras[camera] for camera in best.shot.cameras)
    prefixes = ("",) if is_one else result.cameras
    sigma_now, sigma_then = (
        {
            name.removeprefix("."): sigma
            for name, sigma in _lens_sigmas(problem, covariance, prefixes).items()
        }
        for covariance in (end.covariance, best.covariance)
    )
    parameter = min(sigma_then, key=lambda name: sigma_then[name] / sigma_now[name], default=None)
    for name in result.gauge:
        key = name.removeprefix(f"{result.cameras[0]}.") if is_one else name
        if key in sigma_now:
            sigma_now[key] = np.inf
    board = Pose(np.asarray(problem.state.rig_from_board)[0])
    world_from_rig = Pose(result.world_from_board[0]) @ board.inverse
    return NextShot(
        cameras=names,
        instruction=_instruction(candidate, names, result.cameras),
        world_from_board=np.asarray((world_from_rig @ candidate.rig_from_board).cam_from_world),
        parameter=parameter,
        error_now_px=best.error_now_px,
        error_then_px=best.error_then_px,
        sigma_now=sigma_now,
        sigma_then=sigma_then,
    )


def _instruction(candidate: Candidate, names: Sequence[str], cameras: Sequence[str]) -> str:
    """Text that describes how to hold the board.

    names : names of the cameras that would see the board.
    cameras : names of all cameras.
    """
    if len(cameras) == 1:
        return f"hold the board {candidate.instruction.replace('its image', 'the image')}"
    *others, last = names
    viewers = f"{', '.join(others)} and {last}" if others else last
    decimals = "0f" if candidate.distance_mm >= 100.0 else "3g"
    return (
        f"show the board to {viewers}, {candidate.distance_mm:.{decimals}} mm from "
        f"{cameras[candidate.camera]}, {candidate.instruction}"
    )


def covariance_with_weak_prior(information: Information) -> Float[np.ndarray, "f f"]:
    """Covariance, (f, f), of the estimated parameters with an additional weak prior.

    The prior gives undetermined directions a finite variance.
    """
    free = information.free
    observed = information.shot_information.sum(axis=0)[np.ix_(free, free)] + information.prior
    eigenvalues, directions = np.linalg.eigh(observed)
    variance = 1 / (np.maximum(eigenvalues, 0.0) + 1 / information.tuning.advice.prior_sigma**2)
    return (directions * variance) @ directions.T


def _best_shot(
    problem: Problem, covariance: Float[np.ndarray, "f f"], variance_factor: float
) -> _BestShot | None:
    """Choose the best of `candidate_shots`. None if no camera would detect the board in any of
    them.

    covariance : (f, f) covariance of lenses, cameras and board from the present shots.
    """
    shots = foresee_shots(problem, candidate_shots(problem))
    if not shots:
        return None
    now = np.array([shot_error_px(shot, covariance) for shot in shots])
    largest_number = problem.tuning.advice.most_compared
    compared = [shots[k] for k in np.argsort(-now, kind="stable")[:largest_number]]
    after = [add_shot(covariance, shot, variance_factor) for shot in compared]
    then = [max(shot_error_px(candidate, changed) for candidate in compared) for changed in after]
    best = int(np.argmin(then))
    return _BestShot(compared[best], after[best], float(now.max()), then[best])


def shot_error_px(shot: ForeseenShot, covariance: Float[np.ndarray, "f f"]) -> float:
    """Root mean square pixel error of a shot's board points that errors of lenses, cameras and
    board cause.

    covariance : (f, f) covariance of these errors.
    """
    variance = float(np.sum(shot.information * covariance))
    return shot.sigma_px * float(np.sqrt(max(variance, 0.0) / shot.point_count))


def add_shot(
    covariance: Float[np.ndarray, "f f"], shot: ForeseenShot, variance_factor: float
) -> Float[np.ndarray, "f f"]:
    """Predicted covariance, (f, f), after a shot was added.

    variance_factor : noise variance of the shots relative to that of the point sigmas.
    """
    gained = covariance @ (shot.information / variance_factor)
    after = np.linalg.solve(np.eye(len(covariance)) + gained, covariance)
    return 0.5 * (after + after.T)


def _lens_sigmas(
    problem: Problem, covariance: Float[np.ndarray, "f f"], cameras: tuple[str, ...]
) -> dict[str, float]:
    """Standard deviation of each estimated lens parameter, by name such as "camera.fx_px".

    Spline coefficients are omitted.
    """
    names, scale = (
        shared_parameter_names(problem, cameras),
        np.ravel(problem.parametrization.lens_scale),
    )
    free = np.flatnonzero(problem.free)
    lens_columns = free[free < len(scale)]
    sigma = np.sqrt(np.diag(covariance)[: len(lens_columns)])
    return {
        names[k]: float(scale[k] * s)
        for k, s in zip(lens_columns, sigma, strict=True)
        if names[k].rpartition(".")[2] not in SPLINE_PARAMETERS
    }
