"""Refinement of a rig from its calibration and from matched segments, with rounds of new matches.

Wrong matches agree with almost any rig after its cameras were fitted to them. Residuals do not show
this, since the matcher has selected the tracks that fit. Therefore the refinement is repeated from
initial rigs in which one camera is rotated. The results of these show how probable a wrong result
can be in this scene. A correct result is clearly more probable.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.bundle.estimate import FreeParameters, joint_estimate, squared_distances_with_rig
from trinoc.calib.bundle.result import RefineResult, RefineStatus
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import CalibrationError, InputError, check_kind, list_names
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.rig import A_RIG, Rig
from trinoc.geometry.rotation import rotation_from_vector
from trinoc.geometry.segments import LineObservations
from trinoc.numerics.precision import as_numpy, in_float64

# numerical: largest number of rounds of matching and refining.
MOST_ROUNDS = 8


@runtime_checkable
class MatchedTracks(Protocol):
    """Protocol of matches that provide the observations of their lines, such as `Matches`."""

    def line_observations(self) -> LineObservations:
        """Fragments of each track in the images, with their covariance and the
        triangulated lines.
        """
        ...


# Expected argument, for error messages.
A_MATCH = "Matches, such as match_segments finds"
Matcher = Callable[[Rig], MatchedTracks | LineObservations]


@in_float64
def refine(
    calibrated: CalibrationResult | Rig,
    matches: MatchedTracks | LineObservations,
    *,
    pose_model: PoseModel | str | None = None,
    free_lens: bool | None = None,
    moved: Collection[str] = (),
    match_again: Matcher | Sequence[Matcher] | None = None,
    start: Rig | None = None,
    tuning: CalibTuning = TUNING,
) -> RefineResult:
    """Refine cameras and 3-D lines together by maximum likelihood, from a calibration and matches.

    Parameters
    ----------
    calibrated : result of a calibration, or a rig. Its covariance is the Gaussian prior of the
        cameras. If a rig has no covariance, its position, orientation and scale do not change;
        `gauge` of the result describes them.
    matches : matched tracks, such as `Matches`. Cameras of the rig without matches are omitted.
    pose_model : estimated parameters of each pose. Default: the parameters in the covariance;
        without a covariance, "rigid".
    free_lens : whether focal lengths and principal points are estimated. Default: only if they are
        in the covariance, with this prior.
    moved : names of cameras that were knocked since the calibration. Their poses have no prior, and
        they need not aim at the origin of the sheet.
    match_again : function that matches with a given rig, for example `lambda rig:
        trinoc.match_segments(segments, rig)`. It is called with each refined rig until the tracks
        stop changing. A round that lowers the log posterior is rejected. After a large motion of a
        camera, give several functions, the most tolerant one first (with a larger `sigma_px`). Each
        function then starts from the rig refined with the previous one.
    start : initial rig, if it differs from the calibrated one.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    The refined rig and lines.

    Raises
    ------
    InputError : matches and rig do not belong together.
    CalibrationError : there is no track.
    """
    rig = calibrated.rig if isinstance(calibrated, CalibrationResult) else calibrated
    check_kind(rig, Rig, "rig", A_RIG)
    rig = rig_of_tracks(rig, matches)
    unknown = sorted(set(moved) - set(rig.names))
    if unknown:
        raise InputError(
            f"`moved` names {list_names(unknown)}, but the cameras of the matches are "
            f"{list_names(rig)}."
        )
    trusted = tuple(name for name in rig.names if name not in moved)
    usual_model = _usual_pose_model(rig)
    requested_model = None if pose_model is None else PoseModel.of(pose_model)
    # Aims are fixed by a narrow prior and not by another model: a knocked camera need not aim at
    # the origin any more, and one program handles both.
    aim_fixed = requested_model is None and usual_model is PoseModel.AIMED
    model = PoseModel.AIM_FREE if aim_fixed else requested_model or usual_model
    has_lens_covariance = any(
        name.rpartition(".")[2] in AFFINE_PARAMETERS for name in rig.parameters
    )
    with_lens = has_lens_covariance if free_lens is None else free_lens
    free_parameters = FreeParameters(
        model, with_lens, trusted, aim_fixed, lens_fixed=free_lens is None
    )
    refinement = _Refinement(calibrated, rig, free_parameters, tuning)
    first = refinement.refine_matches(start.take(rig.names) if start else rig, matches)
    if match_again is None:
        return first
    matchers = [match_again] if callable(match_again) else list(match_again)
    best = refinement.repeat_while_better(first, matchers[-1])
    if len(matchers) > 1:
        best = more_probable(best, refinement.refine_from(rig, matchers))
    aimed = model is PoseModel.AIMED or (aim_fixed and not moved)
    turned_rigs = start_rigs(rig, moved, tuning, aimed=aimed)
    other_results = [refinement.refine_from(start, matchers) for start in turned_rigs]
    for result in other_results:
        best = more_probable(best, result)
    if other_results and not is_unambiguous(best, other_results, free_parameters, tuning):
        return dataclasses.replace(best, status=RefineStatus.AMBIGUOUS, rig=rig)
    return best


class _Refinement(NamedTuple):
    """Inputs that all rounds of matching and refining have in common.

    Attributes
    ----------
    calibrated : the calibration.
    sheet_rig : calibrated rig, whose covariance is the prior.
    free_parameters : estimated parameters, and the cameras that keep their prior.
    tuning : constants of the method.
    """

    calibrated: CalibrationResult | Rig
    sheet_rig: Rig
    free_parameters: FreeParameters
    tuning: CalibTuning

    def refine_matches(self, rig: Rig, matches: MatchedTracks | LineObservations) -> RefineResult:
        """Refine given matches. `rig` contains the initial cameras."""
        lines = _observations_of_rig(matches, rig)
        return joint_estimate(
            rig, self.sheet_rig, lines, self.free_parameters, self.calibrated, self.tuning
        )

    def match_and_refine(self, rig: Rig, match: Matcher) -> RefineResult | None:
        """Match with a rig, and refine the matches. None without tracks, or if the fit does not
        converge.
        """
        lines = _line_observations(match(rig))
        if len(lines) == 0:
            return None
        result = self.refine_matches(rig, lines)
        return None if result.status is RefineStatus.NOT_CONVERGED else result

    def refine_from(self, rig: Rig, matchers: Sequence[Matcher]) -> RefineResult | None:
        """Match and refine with each matcher in turn, starting from a rig.

        Returns the last result. None if the last matcher gave none.
        """
        result = None
        for match in matchers:
            result = self.match_and_refine(rig, match)
            if result is not None:
                result = self.repeat_while_better(result, match)
                rig = result.rig
        return result

    def repeat_while_better(self, best: RefineResult, match: Matcher) -> RefineResult:
        """Match and refine again as long as the log posterior increases."""
        history = [best.log_posterior]
        if best.status is RefineStatus.NOT_CONVERGED:
            return best
        for _ in range(MOST_ROUNDS):
            candidate = self.match_and_refine(best.rig, match)
            # The stopping rule of a refinement leaves about a hundredth.
            if candidate is None or candidate.log_posterior < best.log_posterior + 0.01:
                break
            best = candidate
            history.append(best.log_posterior)
        return dataclasses.replace(best, history=tuple(history))


def more_probable(best: RefineResult, candidate: RefineResult | None) -> RefineResult:
    """Return the result with the larger log posterior; `candidate` if `best` did not converge."""
    if candidate is None:
        return best
    failed = best.status is RefineStatus.NOT_CONVERGED
    return candidate if failed or candidate.log_posterior > best.log_posterior else best


def _usual_pose_model(rig: Rig) -> PoseModel:
    parameters = {name.rpartition(".")[2] for name in rig.parameters}
    for pose_model in (PoseModel.AIM_FREE, PoseModel.AIMED):
        if parameters >= set(pose_model.parameter_names):
            return pose_model
    return PoseModel.RIGID


def _line_observations(matches: MatchedTracks | LineObservations) -> LineObservations:
    check_kind(matches, (MatchedTracks, LineObservations), "set of matches", A_MATCH)
    return matches if isinstance(matches, LineObservations) else matches.line_observations()


def rig_of_tracks(rig: Rig, matches: MatchedTracks | LineObservations) -> Rig:
    """Rig of only the cameras that observe the tracks.

    Raises `InputError` if one of these cameras is not in the rig.
    """
    views = _line_observations(matches).views
    _expect_cameras(set(views) <= set(rig.names), views, rig)
    return rig.take(views)


def _expect_cameras(belong: bool, views: Sequence[str], rig: Rig) -> None:
    if not belong:
        raise InputError(
            f"The matches are of the views {list_names(views)}, but the rig has the cameras "
            f"{list_names(rig)}: give the rig that these matches were made with."
        )


def _observations_of_rig(matches: MatchedTracks | LineObservations, rig: Rig) -> LineObservations:
    lines = _line_observations(matches)
    _expect_cameras(set(lines.views) == set(rig.names), lines.views, rig)
    if len(lines) == 0:
        raise CalibrationError(
            "There is no track to refine with: match segments of overlapping images first."
        )
    order = [lines.views.index(name) for name in rig.names]
    return LineObservations(
        rig.names,
        lines.fragments_px[:, order],
        lines.covariance_px2[:, order],
        lines.seen[:, order],
        lines.lines_mm,
    )


def start_rigs(rig: Rig, moved: Collection[str], tuning: CalibTuning, *, aimed: bool) -> list[Rig]:
    """Alternative initial rigs, in which one camera is rotated about its x or y axis.

    There are four of them, for both directions of both axes. The rotated camera is the last one in
    `moved`, or the last one of all. The list is empty if the calibration determines the orientation
    of this camera well.

    aimed : whether the camera must look at the origin of the sheet. If True, the camera is rotated
        about the origin.
    """
    name = next(camera for camera in reversed(rig.names) if camera in moved or not moved)
    small_deg = tuning.bundle.known_share * tuning.bundle.turn_deg
    if not moved and (_angle_sigmas_deg(rig, name) < small_deg).all():
        return []
    pose, poses = rig[name].pose, []
    for axis in (*np.eye(3)[:2], *-np.eye(3)[:2]):
        if aimed:
            turn = np.radians(tuning.bundle.round_deg) * axis
            rotation = rotation_from_vector(turn) @ pose.rotation
            distance = jnp.linalg.norm(pose.centre_world_mm)
            poses.append(Pose.from_aim(rotation, distance, np.zeros(2)))
        else:
            turn = np.append(np.radians(tuning.bundle.turn_deg) * axis, np.zeros(3))
            poses.append(pose.retract(turn, PoseModel.RIGID, 1.0))
    return [
        eqx.tree_at(lambda start: start[name].pose, rig, as_numpy(turned_pose))
        for turned_pose in poses
    ]


def _angle_sigmas_deg(rig: Rig, name: str) -> Float[np.ndarray, "3"]:
    """Sigmas of pan, tilt and swing of a camera for an exact lens, degrees, (3,); NaN if unknown.

    A lens error also changes the pose, but this change does not prevent correct matches.
    """
    angles = [f"{name}.{angle}_deg" for angle in ("pan", "tilt", "swing")]
    if not set(angles) <= set(rig.parameters):
        return np.full(3, np.nan)
    covariance = rig.covariance_of([*angles, *(f"{name}.{key}" for key in AFFINE_PARAMETERS)])
    across, lens = covariance[:3, 3:], covariance[3:, 3:]
    explained = across @ np.linalg.pinv(lens, hermitian=True) @ across.T
    return np.sqrt(np.maximum(np.diag(covariance[:3, :3] - explained), 0.0))


def is_unambiguous(
    best: RefineResult,
    others: Sequence[RefineResult | None],
    free_parameters: FreeParameters,
    tuning: CalibTuning,
) -> bool:
    """True if the best result is much more probable than every other result that differs from it.

    others : results from other initial rigs; None if a refinement failed.
    """
    return all(
        other.log_posterior * tuning.bundle.clear_factor < best.log_posterior
        or _separation_sigmas(best, other, free_parameters) < tuning.bundle.same_sigmas
        for other in others
        if other is not None
    )


def _separation_sigmas(
    best: RefineResult, other: RefineResult, free_parameters: FreeParameters
) -> float:
    """Misfit, in sigmas, of the best result's tracks if the cameras of another result are used.

    It is the median over the tracks that agree with the best result. It is small if both rigs are
    nearly equal.
    """
    agree = (best.inlier == best.tracks.seen).all(axis=1) & (best.tracks.seen.sum(axis=1) > 2)
    if not agree.any():
        return 0.0
    squared = squared_distances_with_rig(other.rig, best.tracks, free_parameters)[agree]
    redundancy = 2 * best.tracks.seen[agree].sum(axis=1) - 4
    return float(np.median(np.sqrt(squared.sum(axis=1) / redundancy)))
