"""Which shot to take next: the one after which lenses and rig err least where they err most."""

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
from trinoc.calib.advice.halves import head_names
from trinoc.calib.problem.information import Information
from trinoc.calib.problem.problem import Problem
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.errors import InputError, check_kind
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import in_float64


class NextShot(NamedTuple):
    """A shot to take next.

    Fields
    ------
    cameras : which would see the board.
    words : how to hold it.
    world_from_board : (3, 4) the pose that these words mean, mm.
    parameter : the parameter of a lens that would gain most; None if all lenses are held.
    error_now_px : the largest error of lenses and rig over all candidate shots: root mean square
        distance by which they miss the shot's corners, its board placed as well as possible.
    error_then_px : the same with this shot added.
    sigma_now, sigma_then : standard deviations of the lenses' parameters, by name; infinite for
        those that are not determined.
    """

    cameras: tuple[str, ...]
    words: str
    world_from_board: Float[np.ndarray, "3 4"]
    parameter: str | None
    error_now_px: float
    error_then_px: float
    sigma_now: Mapping[str, float]
    sigma_then: Mapping[str, float]

    @property
    def sentence(self) -> str:
        """The advice for people."""
        name = self.parameter
        if name is not None and not np.isfinite(self.sigma_now[name]):
            return f"Next, {self.words}: it would determine {name} to {self.sigma_then[name]:.2g}."
        share = 100.0 * (1.0 - self.error_then_px / self.error_now_px)
        sentence = (
            f"Next, {self.words}: the largest error of lenses and cameras would fall by "
            f"{max(share, 0.0):.0f} %"
        )
        if name is None:
            return f"{sentence}."
        now, then = self.sigma_now[name], self.sigma_then[name]
        return (
            f"{sentence}; most of all, the sigma of {name} would fall from {now:.2g} to {then:.2g}."
        )


class _BestShot(NamedTuple):
    """A shot, the covariance of the head with it added, and the errors before and after."""

    shot: ForeseenShot
    covariance: Float[np.ndarray, "f f"]
    error_now_px: float
    error_then_px: float


@in_float64
def next_shot(result: CalibrationResult) -> NextShot | None:
    """Return the shot that lowers most the largest error of lenses and cameras.

    Compared are shots of the board in nine positions of each camera's image, at two distances, and
    tilted in four ways or not, seen by every camera in whose image it then lies.

    Parameters
    ----------
    result : of `calibrate_rig` or `calibrate_intrinsics`; its parameters need not be determined.

    Returns
    -------
    The shot; None if no camera would see it.

    Raises
    ------
    InputError : a result of another calibration, or of a fit that did not converge.
    """
    check_kind(result, CalibrationResult, "result", "what calibrate_rig returns")
    end = result.ended
    if end is None:
        why = result.overall_status.value if result.views else "It is not of many shots."
        raise InputError(f"There is no rig that a shot could be added to: {why}")
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
        words=_words(candidate, names, result.cameras),
        world_from_board=np.asarray((world_from_rig @ candidate.rig_from_board).cam_from_world),
        parameter=parameter,
        error_now_px=best.error_now_px,
        error_then_px=best.error_then_px,
        sigma_now=sigma_now,
        sigma_then=sigma_then,
    )


def _words(candidate: Candidate, names: Sequence[str], cameras: Sequence[str]) -> str:
    """How to hold the board. names : of the cameras that would see it."""
    if len(cameras) == 1:
        return f"hold the board {candidate.words.replace('its picture', 'the picture')}"
    *others, last = names
    shown = f"{', '.join(others)} and {last}" if others else last
    away = candidate.distance_mm
    return (
        f"show the board to {shown}, {away:.{'0f' if away >= 100.0 else '3g'}} mm from "
        f"{cameras[candidate.camera]}, {candidate.words}"
    )


def weakly_known_covariance(information: Information) -> Float[np.ndarray, "f f"]:
    """Covariance of the free steps under a weak prior, so that open directions have a variance.

    Rounding may leave less than no information on a direction that is not determined.
    """
    free = information.free
    observed = information.of_shot.sum(axis=0)[np.ix_(free, free)] + information.prior
    eigenvalues, directions = np.linalg.eigh(observed)
    variance = 1 / (np.maximum(eigenvalues, 0.0) + 1 / information.tuning.advice.prior_sigma**2)
    return (directions * variance) @ directions.T


def _best_shot(
    problem: Problem, covariance: Float[np.ndarray, "f f"], variance_factor: float
) -> _BestShot | None:
    """Compared are shots of the board in nine places of each camera's picture, at two distances,
    and tilted in four ways or not, seen by every camera in whose picture it then lies."""
    shots = foresee_shots(problem, candidate_shots(problem))
    if not shots:
        return None
    now = np.array([shot_error_px(shot, covariance) for shot in shots])
    most = problem.tuning.advice.most_compared
    compared = [shots[k] for k in np.argsort(-now, kind="stable")[:most]]
    after = [add_shot(covariance, shot, variance_factor) for shot in compared]
    then = [max(shot_error_px(each, changed) for each in compared) for changed in after]
    best = int(np.argmin(then))
    return _BestShot(compared[best], after[best], float(now.max()), then[best])


def shot_error_px(shot: ForeseenShot, covariance: Float[np.ndarray, "f f"]) -> float:
    """Root mean square length by which a rig of this covariance misses the shot's places."""
    variance = float(np.sum(shot.information * covariance))
    return shot.sigma_px * float(np.sqrt(max(variance, 0.0) / shot.places))


def add_shot(
    covariance: Float[np.ndarray, "f f"], shot: ForeseenShot, variance_factor: float
) -> Float[np.ndarray, "f f"]:
    """The covariance with a shot added, whose noise is enlarged as that of the others was."""
    gained = covariance @ (shot.information / variance_factor)
    after = np.linalg.solve(np.eye(len(covariance)) + gained, covariance)
    return 0.5 * (after + after.T)


def _lens_sigmas(
    problem: Problem, covariance: Float[np.ndarray, "f f"], cameras: tuple[str, ...]
) -> dict[str, float]:
    """Standard deviations of what is free of the lenses, splines apart, as "camera.fx_px"."""
    names, scale = head_names(problem, cameras), np.ravel(problem.parametrization.lens_scale)
    free = np.flatnonzero(problem.free)
    of_lens = free[free < len(scale)]
    sigma = np.sqrt(np.diag(covariance)[: len(of_lens)])
    return {
        names[k]: float(scale[k] * s)
        for k, s in zip(of_lens, sigma, strict=True)
        if names[k].rpartition(".")[2] not in SPLINE_PARAMETERS
    }
