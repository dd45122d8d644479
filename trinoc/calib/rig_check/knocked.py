"""Has a camera been knocked since the rig was calibrated? By scene pictures alone.

For each camera in turn the prior of the calibration is dropped, while the others keep theirs. The
fall of the joint chi-square is the evidence that this camera moved; without motion it is
distributed as chi-square with as many degrees of freedom as the camera has parameters.

A large knock hides the scene from the matcher, and lines that were found despite it cannot tell.
So where too little of the scene was found, or a motion shows, it is matched again with each camera
freed.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.bundle.refinement import MatchedTracks, Matcher, refine, rig_of_tracks
from trinoc.calib.bundle.result import RefineResult, RefineStatus
from trinoc.calib.rig_check.comparison import sigmas_of_chi_square
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import CalibrationError, check_kind
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.rig import A_RIG, Rig
from trinoc.geometry.segments import LineObservations
from trinoc.numerics.values import Value


@runtime_checkable
class CountedTracks(Protocol):
    """Tracks that know how much of the pictures they explain, as the matcher's answer does."""

    @property
    def share_in_three_views(self) -> float:
        """The share of a view's segments on sure tracks of three views, where it is least."""
        ...


class CameraMotion(Value):
    """How far the scene's segments place one camera from where the sheet had placed it.

    Fields
    ------
    name : of the camera.
    sigmas : significance of the motion, as sigmas of a normal distribution (two-sided).
    parameters : names, such as "pan_deg".
    change : (p,) of the parameters, scene minus sheet, in degrees and mm.
    sigma : (p,) of the change, both sides' errors together.
    """

    name: str = eqx.field(static=True)
    sigmas: float = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    change: Float[np.ndarray, "p"]
    sigma: Float[np.ndarray, "p"]


class RigCheck(Value):
    """Whether a rig still stands as it was calibrated.

    Fields
    ------
    motions : per camera, were it the only one that moved.
    moved : names of the cameras to suspect, the most significant first; others follow where
        freeing the first does not explain the scene.
    refined : the rig with the suspect camera corrected by the segments; None where nothing
        moved, or where more moved than segments can correct.
    conclusive : whether the scene decides; where it does not, an empty `moved` proves nothing.
    suspect_sigmas : significance from which on a motion was suspected.
    """

    motions: tuple[CameraMotion, ...]
    moved: tuple[str, ...] = eqx.field(static=True)
    refined: RefineResult | None
    conclusive: bool = eqx.field(static=True, default=True)
    suspect_sigmas: float = eqx.field(static=True, default=TUNING.rig_check.suspect_sigmas)

    def summary(self) -> str:
        """One sentence of verdict, one line per camera, and how a suspected one has moved."""
        if not self.conclusive:
            return (
                "This scene does not tell whether a camera moved: too few of its lines agree in "
                "three views, or rigs that differ explain them about as well. A large knock hides "
                "them from the matcher: match the pictures again while checking, show a scene of "
                "more edges, or calibrate the rig again with the sheet."
            )
        if not self.moved:
            verdict = "No camera has moved by more than the error bars allow."
        elif self.refined is not None:
            verdict = f'Camera "{self.moved[0]}" has moved; the segments tell where it is now.'
        else:
            verdict = (
                "More than one camera has moved, which segments alone cannot correct: "
                "calibrate the rig again with the sheet."
            )
        rows = [verdict]
        for motion in self.motions:
            rows.append(f"{motion.name}: {motion.sigmas:.1f} sigma if it alone moved")
            if motion.sigmas >= self.suspect_sigmas:
                rows += [
                    f"  {name:<12} {change:+10.4f} +- {sigma:.4f}"
                    for name, change, sigma in zip(
                        motion.parameters, motion.change, motion.sigma, strict=True
                    )
                ]
        return "\n".join(rows)


def check_rig(
    rig: Rig,
    matches: MatchedTracks | LineObservations,
    *,
    match_again: Matcher | Sequence[Matcher] | None = None,
    tuning: CalibTuning = TUNING,
) -> RigCheck:
    """Test by the segments of a scene whether each camera still stands where `rig` says.

    `rig` needs the covariance of its calibration, since motion is measured against it. With
    `match_again`, as `refine` takes it, a knock that hid most of the scene from the matcher is
    found too: unless most of the scene is on sure tracks of three views that call for no
    motion, it is matched again with each camera freed, and tested where that is most probable.
    `tuning` holds every tuned constant of calibration; a benchmark or a study changes them.
    Raises CalibrationError where the rig has no covariance or where fewer than three cameras
    see the scene: two views of lines agree with any motion.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    rig = rig_of_tracks(rig, matches)
    if not rig.parameters or len(rig) < 3:
        raise CalibrationError(
            "Whether a camera moved can be told only for three or more cameras with the "
            "covariance of their calibration: give the rig.json that `trinoc calibrate` wrote."
        )
    best = None
    suspect_sigmas = tuning.rig_check.suspect_sigmas
    motions, freed = _motions(rig, matches, tuning)
    if match_again is not None and not _is_at_rest(matches, motions, freed, tuning):
        refined = [
            refine(rig, matches, moved=(name,), match_again=match_again, tuning=tuning)
            for name in rig.names
        ]
        refined = [result for result in refined if result.status is RefineStatus.CONVERGED]
        if not refined:
            return RigCheck(motions, (), None, False, suspect_sigmas)
        best = max(refined, key=lambda result: result.log_posterior)
        matches = best.tracks
        motions, freed = _motions(rig, matches, tuning, best)
    strongest = max(motions, key=lambda motion: motion.sigmas)
    corrected, name = freed[strongest.name], strongest.name
    is_clear = best is not None or _is_quiet(corrected, tuning)
    conclusive = _have_enough_lines(corrected, tuning) and is_clear
    if strongest.sigmas < suspect_sigmas:
        return RigCheck(motions, (), None, conclusive, suspect_sigmas)
    others = [other for other in rig.names if other != name]
    noise, further = max(corrected.segment_sigma_factor, 1.0), {}
    for other in others:
        both = _free_cameras(corrected, rig, matches, (name, other), tuning)
        further[other] = _significance(corrected, both, noise)
    also = tuple(other for other in others if further[other] >= suspect_sigmas)
    if also or corrected.status is RefineStatus.NOT_CONVERGED:
        return RigCheck(motions, (name, *also), None, suspect_sigmas=suspect_sigmas)
    if not conclusive:
        return RigCheck(motions, (), None, conclusive, suspect_sigmas)
    return RigCheck(motions, (name,), corrected, suspect_sigmas=suspect_sigmas)


def _is_at_rest(
    matches: MatchedTracks | LineObservations,
    motions: Sequence[CameraMotion],
    freed: Mapping[str, RefineResult],
    tuning: CalibTuning,
) -> bool:
    """Whether the rig as it stands explains most of the scene, and nothing calls for a motion."""
    limits = tuning.rig_check
    return (
        isinstance(matches, CountedTracks)
        and matches.share_in_three_views >= limits.clear_share
        and all(motion.sigmas < limits.suspect_sigmas for motion in motions)
        and all(
            _is_quiet(result, tuning) and _have_enough_lines(result, tuning)
            for result in freed.values()
        )
    )


def _is_quiet(result: RefineResult, tuning: CalibTuning) -> bool:
    return result.segment_sigma_factor < tuning.rig_check.most_noise


def _have_enough_lines(result: RefineResult, tuning: CalibTuning) -> bool:
    agree_in_three = result.inlier.sum(axis=1) > 2
    return bool(agree_in_three.sum() >= tuning.rig_check.fewest_lines)


def _motions(
    rig: Rig,
    matches: MatchedTracks | LineObservations,
    tuning: CalibTuning,
    best: RefineResult | None = None,
) -> tuple[tuple[CameraMotion, ...], dict[str, RefineResult]]:
    """The motion of each camera were it the only one, and the rig with it freed.

    `best` is where the scene was matched best: one more start for each camera.
    """
    at_rest = refine(rig, matches, tuning=tuning)
    freed = {name: _free_cameras(best, rig, matches, (name,), tuning) for name in rig.names}
    # The best explanation sets the noise; a moved camera would inflate it otherwise.
    noise = min(result.segment_sigma_factor for result in (at_rest, *freed.values()))
    noise = max(noise, 1.0)
    motions = tuple(_motion(rig, name, at_rest, freed[name], noise) for name in rig.names)
    return motions, freed


def _free_cameras(
    best: RefineResult | None,
    rig: Rig,
    matches: MatchedTracks | LineObservations,
    names: tuple[str, ...],
    tuning: CalibTuning,
) -> RefineResult:
    """The rig with cameras freed, from where it stood or from the rig of `best`, if cheaper."""
    freed = refine(rig, matches, moved=names, tuning=tuning)
    if best is None:
        return freed
    again = refine(rig, matches, moved=names, start=best.rig, tuning=tuning)
    return min(freed, again, key=lambda result: result.chi_square[0])


def _motion(
    rig: Rig, name: str, at_rest: RefineResult, freed: RefineResult, noise: float
) -> CameraMotion:
    rows = [i for i in _pose_rows(freed) if freed.parameters[i].rpartition(".")[0] == name]
    keys = [freed.parameters[i] for i in rows]
    sheet = np.nan_to_num([rig.sigma(key) for key in keys])
    change = freed.values[rows] - [rig.value(key) for key in keys]
    angles = np.array([key.endswith("_deg") for key in keys])
    change = np.where(angles, (change + 180) % 360 - 180, change)
    variance = np.diag(freed.covariance)[rows] + sheet**2
    own = tuple(key.removeprefix(name + ".") for key in keys)
    sigmas = _significance(at_rest, freed, noise)
    return CameraMotion(name, sigmas, own, change, np.sqrt(variance))


def _significance(held: RefineResult, freed: RefineResult, noise: float) -> float:
    """Sigmas by which the scene prefers one more camera without its prior."""
    gain = max(held.chi_square[0] - freed.chi_square[0], 0.0) / noise**2
    return sigmas_of_chi_square(gain, len(_pose_rows(freed)) // len(freed.rig))


def _pose_rows(result: RefineResult) -> list[int]:
    """Rows of the parameters that a knock changes: a camera keeps its lens."""
    own = [parameter.rpartition(".")[2] for parameter in result.parameters]
    return [row for row, parameter in enumerate(own) if parameter not in AFFINE_PARAMETERS]
