"""Which shot to take next: the one after which lenses and rig err least where they err most."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.foreseen_shots import ForeseenShot, candidate_shots, foresee_shots
from trinoc.calib.advice.halves import head_names
from trinoc.calib.problem.problem import Problem
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.lenses.splined import SPLINE_PARAMETERS
from trinoc.geometry.pose import Pose


class NextShot(NamedTuple):
    """A shot to take next.

    Fields
    ------
    cameras : which would see the board.
    words : how to hold it.
    world_from_board : (3, 4) the pose that these words mean, mm.
    error_now_px : root mean square length by which lenses and rig miss the places of the shot of
        which they tell least, its board placed as well as can be, by their own errors alone.
    error_then_px : the same, of all shots, with this one added.
    sigma_now, sigma_then : standard deviations of the lenses' parameters, by name.
    """

    cameras: tuple[str, ...]
    words: str
    world_from_board: Float[np.ndarray, "3 4"]
    error_now_px: float
    error_then_px: float
    sigma_now: Mapping[str, float]
    sigma_then: Mapping[str, float]

    @property
    def parameter(self) -> str | None:
        """The parameter of a lens that would gain most; None where all lenses are held."""
        return _most_gaining(self.sigma_now, self.sigma_then)

    @property
    def sentence(self) -> str:
        """The advice for people."""
        share = 100.0 * (1.0 - self.error_then_px / self.error_now_px)
        sentence = (
            f"Next, {self.words}: the largest error of lenses and cameras would fall by "
            f"{max(share, 0.0):.0f} %"
        )
        name = self.parameter
        if name is None:
            return f"{sentence}."
        now, then = self.sigma_now[name], self.sigma_then[name]
        return (
            f"{sentence}; most of all, the sigma of {name} would fall from {now:.2g} to {then:.2g}."
        )


class NextImage(NamedTuple):
    """The picture to take next of one camera whose lens is sought.

    Fields
    ------
    words : how to hold the board.
    cam_from_world : (3, 4) the pose that these words mean, mm.
    parameter : what it would teach most about.
    sigma_now : its standard deviation; infinite where it is not determined.
    sigma_then : its standard deviation with this picture added.
    """

    words: str
    cam_from_world: Float[np.ndarray, "3 4"]
    parameter: str
    sigma_now: float
    sigma_then: float

    @property
    def sentence(self) -> str:
        """The advice for people."""
        if not np.isfinite(self.sigma_now):
            gain = f"determine {self.parameter} to {self.sigma_then:.2g}"
        else:
            gain = (
                f"lower the sigma of {self.parameter} from {self.sigma_now:.2g} to "
                f"{self.sigma_then:.2g}"
            )
        return f"Next picture: {self.words}; it would {gain}."


class _BestShot(NamedTuple):
    """A shot, the covariance of the head with it added, and the errors before and after."""

    shot: ForeseenShot
    covariance: Float[np.ndarray, "f f"]
    error_now_px: float
    error_then_px: float


def advise_next_shot(
    problem: Problem,
    covariance: Float[np.ndarray, "f f"],
    variance_factor: float,
    cameras: tuple[str, ...],
    world_from_rig: Pose,
) -> NextShot | None:
    """The shot that lowers most what the rig errs by where it errs most, over all cameras.

    covariance : of the free steps of the head, at the end of a fit. None where the board lies in
    no picture.
    """
    best = _best_shot(problem, covariance, variance_factor)
    if best is None:
        return None
    names = tuple(cameras[camera] for camera in best.shot.cameras)
    candidate = best.shot.candidate
    *others, last = names
    shown = f"{', '.join(others)} and {last}" if others else last
    away = candidate.distance_mm
    return NextShot(
        cameras=names,
        words=f"show the board to {shown}, {away:.{'0f' if away >= 100.0 else '3g'}} mm from "
        f"{cameras[candidate.camera]}, {candidate.words}",
        world_from_board=np.asarray((world_from_rig @ candidate.rig_from_board).cam_from_world),
        error_now_px=best.error_now_px,
        error_then_px=best.error_then_px,
        sigma_now=_lens_sigmas(problem, covariance, cameras),
        sigma_then=_lens_sigmas(problem, best.covariance, cameras),
    )


def advise_next_image(
    problem: Problem,
    information: Float[np.ndarray, "f f"],
    variance_factor: float,
    open_names: Sequence[str],
) -> NextImage | None:
    """The picture that lowers most what a lens errs by where it errs most, determined or not.

    information : of the pictures taken, on the free steps of the lens. open_names : parameters
    that they do not determine.
    """
    # Of a direction that is not determined rounding may leave less than no information.
    known, directions = np.linalg.eigh(information)
    variance = 1 / (np.maximum(known, 0.0) + 1 / TUNING.advice.prior_sigma**2)
    covariance = (directions * variance) @ directions.T
    best = _best_shot(problem, covariance, variance_factor)
    if best is None:
        return None
    now, then = (_lens_sigmas(problem, each, ("",)) for each in (covariance, best.covariance))
    name = _most_gaining(now, then)
    if name is None:
        return None
    parameter = name.removeprefix(".")
    cam_from_rig = Pose(np.asarray(problem.state.cam_from_rig)[0])
    return NextImage(
        words=f"hold the board {best.shot.candidate.words.replace('its picture', 'the picture')}",
        cam_from_world=np.asarray(
            (cam_from_rig @ best.shot.candidate.rig_from_board).cam_from_world
        ),
        parameter=parameter,
        sigma_now=np.inf if parameter in open_names else now[name],
        sigma_then=then[name],
    )


def _best_shot(
    problem: Problem, covariance: Float[np.ndarray, "f f"], variance_factor: float
) -> _BestShot | None:
    """Compared are shots of the board in nine places of each camera's picture, at two distances,
    and tilted in four ways or not, seen by every camera in whose picture it then lies."""
    shots = foresee_shots(problem, candidate_shots(problem))
    if not shots:
        return None
    now = np.array([shot_error_px(shot, covariance) for shot in shots])
    compared = [shots[k] for k in np.argsort(-now, kind="stable")[: TUNING.advice.most_compared]]
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


def _most_gaining(now: Mapping[str, float], then: Mapping[str, float]) -> str | None:
    return min(then, key=lambda name: then[name] / now[name]) if then else None


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
