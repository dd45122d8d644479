"""Which shot to take next: the one after which the rig errs least where it errs most."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.motions import chained, inverse
from trinoc.calib.shots.candidate_shots import candidate_shots
from trinoc.calib.shots.foreseen import ForeseenShot, foreseen
from trinoc.calib.shots.halves import head_names
from trinoc.calib.shots.result import RigFromShots
from trinoc.errors import InputError
from trinoc.geometry import SPLINE_PARAMETERS
from trinoc.numerics import in_float64

# Of all candidates so many are compared: those of which the rig tells least.
_MOST_COMPARED = 40


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
        gain = {name: then / self.sigma_now[name] for name, then in self.sigma_then.items()}
        return min(gain, key=lambda name: gain[name]) if gain else None

    @property
    def sentence(self) -> str:
        """The advice for people."""
        told = (
            f"Next, {self.words}: where lenses and cameras are known worst, they would then err by "
            f"{self.error_then_px:.2g} px instead of {self.error_now_px:.2g} px"
        )
        name = self.parameter
        if name is None:
            return f"{told}."
        now, then = self.sigma_now[name], self.sigma_then[name]
        return f"{told}; most of all, the sigma of {name} would fall from {now:.2g} to {then:.2g}."


@in_float64
def next_shot(result: RigFromShots) -> NextShot | None:
    """The shot that lowers most what the rig errs by where it errs most, over all cameras.

    Compared are shots of the board in nine places of each camera's picture, at two distances, and
    tilted in four ways or not, seen by every camera in whose picture it then lies. None where it
    lies in no picture. Raises InputError for a result that did not converge.
    """
    end = result.ended
    if end is None:
        raise InputError(f"There is no rig that a shot could be added to: {result.status.value}")
    problem = end.problem
    shots = foreseen(problem, candidate_shots(problem))
    if not shots:
        return None
    now = np.array([shot_error_px(shot, end.covariance) for shot in shots])
    compared = [shots[k] for k in np.argsort(-now, kind="stable")[:_MOST_COMPARED]]
    after = [with_shot(end.covariance, shot, end.variance_factor) for shot in compared]
    then = [max(shot_error_px(each, covariance) for each in compared) for covariance in after]
    best = int(np.argmin(then))
    shot = compared[best]
    names = [result.cameras[camera] for camera in shot.cameras]
    candidate = shot.candidate
    world_from_rig = chained(
        result.world_from_board[0], inverse(np.asarray(problem.state.rig_from_board)[0])
    )
    return NextShot(
        cameras=tuple(names),
        words=f"show the board to {_listed(names)}, {_length(candidate.distance_mm)} from "
        f"{result.cameras[candidate.camera]}, {candidate.words}",
        world_from_board=chained(world_from_rig, candidate.rig_from_board),
        error_now_px=float(now.max()),
        error_then_px=then[best],
        sigma_now=_lens_sigmas(result, end.covariance),
        sigma_then=_lens_sigmas(result, after[best]),
    )


def shot_error_px(shot: ForeseenShot, covariance: Float[np.ndarray, "f f"]) -> float:
    """Root mean square length by which a rig of this covariance misses the shot's places."""
    variance = float(np.sum(shot.information * covariance))
    return shot.sigma_px * float(np.sqrt(max(variance, 0.0) / shot.places))


def with_shot(
    covariance: Float[np.ndarray, "f f"], shot: ForeseenShot, variance_factor: float
) -> Float[np.ndarray, "f f"]:
    """The covariance with a shot added, whose noise is enlarged as that of the others was."""
    gained = covariance @ (shot.information / variance_factor)
    after = np.linalg.solve(np.eye(len(covariance)) + gained, covariance)
    return 0.5 * (after + after.T)


def _lens_sigmas(result: RigFromShots, covariance: Float[np.ndarray, "f f"]) -> dict[str, float]:
    assert result.ended is not None
    problem = result.ended.problem
    names, scale = head_names(problem, result.cameras), np.ravel(problem.chart.lens_scale)
    free = np.flatnonzero(problem.chart.free)
    of_lens = free[free < len(scale)]
    sigma = np.sqrt(np.diag(covariance)[: len(of_lens)])
    return {
        names[k]: float(scale[k] * s)
        for k, s in zip(of_lens, sigma, strict=True)
        if names[k].rpartition(".")[2] not in SPLINE_PARAMETERS
    }


def _listed(names: list[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} and {last}" if others else last


def _length(length_mm: float) -> str:
    return f"{length_mm:.0f} mm" if length_mm >= 100.0 else f"{length_mm:.3g} mm"
