"""Test from images of a scene whether a camera was moved since the calibration.

For each camera in turn its calibration prior is omitted, while the others keep theirs. The
reduction of the joint chi-square is the test statistic. Without motion, it has a chi-square
distribution with as many degrees of freedom as the camera has parameters.

After a large motion most of the scene is no longer matched, and the few remaining matches do not
show the motion. Therefore, if too little of the scene is matched or a motion is significant, the
scene is matched again with each camera free.
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
    """Protocol of matches that report which share of the segments they explain, such
    as `Matches`.
    """

    @property
    def share_in_three_views(self) -> float:
        """Fraction of a view's segments that belong to reliable tracks of three views, in the view
        where this fraction is smallest.
        """
        ...


class CameraMotion(Value):
    """Motion of one camera since the calibration, estimated from the segments of a scene.

    Attributes
    ----------
    name : name of the camera.
    sigmas : significance of the motion, as two-sided sigmas of a normal distribution.
    parameters : names of the pose parameters, such as "pan_deg".
    change : (p,) present value minus calibrated value of each parameter, in degrees and mm.
    sigma : (p,) standard deviation of `change`; contains the errors of scene and calibration.
    """

    name: str = eqx.field(static=True)
    sigmas: float = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    change: Float[np.ndarray, "p"]
    sigma: Float[np.ndarray, "p"]


class RigCheck(Value):
    """Result of `check_rig`: the cameras that moved since the calibration.

    Attributes
    ----------
    motions : estimated motion of each camera under the assumption that only this camera moved.
    moved : names of the cameras that are suspected to have moved, the most significant one first.
        There are several if the motion of one camera does not explain the scene.
    refined : rig with the corrected pose of the moved camera. None if no camera moved. None also if
        several cameras moved, because segments cannot correct several poses.
    conclusive : whether the scene is sufficient for a decision. If not, an empty `moved` proves
        nothing.
    suspect_sigmas : significance above which a camera is suspected.
    """

    motions: tuple[CameraMotion, ...]
    moved: tuple[str, ...] = eqx.field(static=True)
    refined: RefineResult | None
    conclusive: bool = eqx.field(static=True, default=True)
    suspect_sigmas: float = eqx.field(static=True, default=TUNING.rig_check.suspect_sigmas)

    def summary(self) -> str:
        """Text with the conclusion, the significance for each camera, and the motion of suspected
        cameras.
        """
        if not self.conclusive:
            return (
                "The scene is not sufficient to decide whether a camera moved: too few lines agree "
                "in three views, or different rigs explain them about as well. Match the images "
                "again while checking, show a scene with more edges, or calibrate the rig again "
                "with the sheet."
            )
        if not self.moved:
            verdict = "No camera has moved significantly."
        elif self.refined is not None:
            verdict = f'Camera "{self.moved[0]}" has moved; its new pose comes from the segments.'
        else:
            verdict = (
                "More than one camera has moved, which segments alone cannot correct: "
                "calibrate the rig again with the sheet."
            )
        rows = [verdict]
        for motion in self.motions:
            rows.append(f"{motion.name}: {motion.sigmas:.1f} sigma if only this camera moved")
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
    """Test from the segments of a scene whether a camera moved since the calibration.

    Parameters
    ----------
    rig : calibrated rig with its covariance. Motion is measured relative to this rig.
    matches : matched tracks, such as `Matches`.
    match_again : functions that match with a given rig, as in `refine`. With them, the test also
        detects a motion so large that most of the scene is no longer matched. Then the scene is
        matched again with each camera free. This is skipped if most of the scene is on reliable
        tracks of three views and no motion is significant.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    The motion of each camera, and the names of the cameras that moved.

    Raises
    ------
    CalibrationError : the rig has no covariance, or the tracks have fewer than three cameras. Lines
        in two views agree with any motion.
    """
    check_kind(rig, Rig, "rig", A_RIG)
    rig = rig_of_tracks(rig, matches)
    if not rig.parameters or len(rig) < 3:
        raise CalibrationError(
            "The test for a moved camera needs three or more cameras and the covariance of "
            "their calibration: give the rig.json that `trinoc calibrate` wrote."
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
    noise, significance = max(corrected.segment_sigma_factor, 1.0), {}
    for other in others:
        two_freed = _free_cameras(corrected, rig, matches, (name, other), tuning)
        significance[other] = _significance(corrected, two_freed, noise)
    other_suspects = tuple(other for other in others if significance[other] >= suspect_sigmas)
    if other_suspects or corrected.status is RefineStatus.NOT_CONVERGED:
        return RigCheck(motions, (name, *other_suspects), None, suspect_sigmas=suspect_sigmas)
    if not conclusive:
        return RigCheck(motions, (), None, conclusive, suspect_sigmas)
    return RigCheck(motions, (name,), corrected, suspect_sigmas=suspect_sigmas)


def _is_at_rest(
    matches: MatchedTracks | LineObservations,
    motions: Sequence[CameraMotion],
    freed: Mapping[str, RefineResult],
    tuning: CalibTuning,
) -> bool:
    """True if the rig as calibrated explains most of the scene, and no motion is significant.

    freed : rig refined with one camera free, by the name of the camera.
    """
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
    """Motion of each camera if only this camera moved, and the rig refined with this camera free.

    best : refinement with the best matches so far; used as an additional initial value.
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
    """Refine a rig with the cameras `names` free, and return the result of least cost.

    The initial values are the calibrated rig and, if given, the rig of `best`.
    """
    freed = refine(rig, matches, moved=names, tuning=tuning)
    if best is None:
        return freed
    restarted = refine(rig, matches, moved=names, start=best.rig, tuning=tuning)
    return min(freed, restarted, key=lambda result: result.chi_square[0])


def _motion(
    rig: Rig, name: str, at_rest: RefineResult, freed: RefineResult, noise: float
) -> CameraMotion:
    rows = [i for i in _pose_rows(freed) if freed.parameters[i].rpartition(".")[0] == name]
    keys = [freed.parameters[i] for i in rows]
    calibration_sigma = np.nan_to_num([rig.sigma(key) for key in keys])
    change = freed.values[rows] - [rig.value(key) for key in keys]
    angles = np.array([key.endswith("_deg") for key in keys])
    change = np.where(angles, (change + 180) % 360 - 180, change)
    variance = np.diag(freed.covariance)[rows] + calibration_sigma**2
    parameters = tuple(key.removeprefix(name + ".") for key in keys)
    sigmas = _significance(at_rest, freed, noise)
    return CameraMotion(name, sigmas, parameters, change, np.sqrt(variance))


def _significance(fixed: RefineResult, freed: RefineResult, noise: float) -> float:
    """Significance, in sigmas, of the reduction of chi-square by freeing one more camera.

    fixed, freed : refinements before and after.
    noise : factor by which the segments' sigmas are multiplied in both chi-squares.
    """
    gain = max(fixed.chi_square[0] - freed.chi_square[0], 0.0) / noise**2
    return sigmas_of_chi_square(gain, len(_pose_rows(freed)) // len(freed.rig))


def _pose_rows(result: RefineResult) -> list[int]:
    """Indices of the pose parameters in `result.parameters`. Lens parameters are omitted."""
    parameters = [parameter.rpartition(".")[2] for parameter in result.parameters]
    return [row for row, parameter in enumerate(parameters) if parameter not in AFFINE_PARAMETERS]
