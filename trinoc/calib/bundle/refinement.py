"""Refine a rig jointly against the sheet it was calibrated with and segments matched by it.

Segments that match by chance agree with almost any rig once its cameras have been fitted to them,
and no residual shows it: the matcher has chosen those that fit. So the refinement is run again from
starts with one camera turned to each side. Those that end elsewhere show what chance is worth in
this scene, and a right answer stands clear of them.
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

# numerical: rounds of matching and refining, which end once nothing is gained.
MOST_ROUNDS = 8


@runtime_checkable
class MatchedTracks(Protocol):
    """Anything that holds tracks of fragments, as the matcher's answer does."""

    def line_observations(self) -> LineObservations:
        """The tracks as observations of lines."""
        ...


# What to give where tracks are wanted.
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
    """Cameras and 3-D lines of maximum likelihood, given a sheet's calibration and matches.

    `calibrated` is the result of a calibration, or a rig. A covariance of the rig is used as a
    Gaussian prior. Without one the gauge (position, orientation and scale of the rig) is held,
    and reported in `gauge`. `pose_model` is what may move in each camera: by default what the
    covariance names, and any rigid motion without one. `free_lens` frees focal lengths and
    principal points too: by default those that the covariance names, each with what it says.
    `moved` names cameras that were knocked since: the prior no longer holds for them, and they
    need not aim at the sheet's origin any more.
    `match_again`, for example `lambda rig: trinoc.match_segments(segments, rig)`, is called
    with each refined rig until the tracks stop changing; a round that lowers the log posterior
    is not accepted. After a large knock give several, the most tolerant first (a larger
    `sigma_px`): each refines the rig for the next, and the last decides.

    `start` is where the cameras start from, where that is not where the sheet placed them.
    `tuning` holds every tuned constant of calibration; a benchmark or a study changes them.
    Cameras of the rig that the matches are not of are left out of the result.

    Raises InputError where matches and rig do not belong together, CalibrationError where no
    track is left.
    """
    rig = calibrated.rig if isinstance(calibrated, CalibrationResult) else calibrated
    check_kind(rig, Rig, "rig", A_RIG)
    rig = rig_of_tracks(rig, matches)
    unknown = sorted(set(moved) - set(rig.names))
    if unknown:
        raise InputError(
            f"There is no camera {list_names(unknown)} that could have moved; the matches are of "
            f"{list_names(rig)}."
        )
    trusted = tuple(name for name in rig.names if name not in moved)
    usual = _usual_pose_model(rig)
    chosen = None if pose_model is None else PoseModel.of(pose_model)
    # Aims that the sheet knows are held by their prior and not by another model: a knocked camera
    # need not aim at the origin any more, and one program serves both.
    aim_held = chosen is None and usual is PoseModel.AIMED
    model = PoseModel.AIM_FREE if aim_held else chosen or usual
    lens_is_open = any(name.rpartition(".")[2] in AFFINE_PARAMETERS for name in rig.parameters)
    is_free = lens_is_open if free_lens is None else free_lens
    choice = FreeParameters(model, is_free, trusted, aim_held, lens_held=free_lens is None)
    refinement = _Refinement(calibrated, rig, choice, tuning)
    first = refinement.refine_matches(start.take(rig.names) if start else rig, matches)
    if match_again is None:
        return first
    matchers = [match_again] if callable(match_again) else list(match_again)
    best = refinement.repeat_while_better(first, matchers[-1])
    if len(matchers) > 1:
        best = more_probable(best, refinement.refine_from(rig, matchers))
    aimed = model is PoseModel.AIMED or (aim_held and not moved)
    turned = start_rigs(rig, moved, tuning, aimed=aimed)
    others = [refinement.refine_from(start, matchers) for start in turned]
    for other in others:
        best = more_probable(best, other)
    if others and not is_unambiguous(best, others, choice, tuning):
        return dataclasses.replace(best, status=RefineStatus.AMBIGUOUS, rig=rig)
    return best


class _Refinement(NamedTuple):
    """What stays the same over all rounds of matching."""

    calibrated: CalibrationResult | Rig
    sheet_rig: Rig
    choice: FreeParameters
    tuning: CalibTuning

    def refine_matches(self, rig: Rig, matches: MatchedTracks | LineObservations) -> RefineResult:
        """The refinement of given matches, from the cameras of a rig."""
        lines = _observations_of_rig(matches, rig)
        return joint_estimate(rig, self.sheet_rig, lines, self.choice, self.calibrated, self.tuning)

    def match_and_refine(self, rig: Rig, match: Matcher) -> RefineResult | None:
        """The refinement from what is found with a rig; None where that leads nowhere."""
        lines = _line_observations(match(rig))
        if len(lines) == 0:
            return None
        result = self.refine_matches(rig, lines)
        return None if result.status is RefineStatus.NOT_CONVERGED else result

    def refine_from(self, rig: Rig, matchers: Sequence[Matcher]) -> RefineResult | None:
        """The most probable rig that the matchers lead to, one after the other."""
        result = None
        for match in matchers:
            result = self.match_and_refine(rig, match)
            if result is not None:
                result = self.repeat_while_better(result, match)
                rig = result.rig
        return result

    def repeat_while_better(self, best: RefineResult, match: Matcher) -> RefineResult:
        """Matched and refined again while that is more probable than what was before."""
        history = [best.log_posterior]
        if best.status is RefineStatus.NOT_CONVERGED:
            return best
        for _ in range(MOST_ROUNDS):
            candidate = self.match_and_refine(best.rig, match)
            # A hundredth is what a refinement leaves to its stopping rule.
            if candidate is None or candidate.log_posterior < best.log_posterior + 0.01:
                break
            best = candidate
            history.append(best.log_posterior)
        return dataclasses.replace(best, history=tuple(history))


def more_probable(best: RefineResult, candidate: RefineResult | None) -> RefineResult:
    """The candidate where it is more probable, or where there was no answer; else the best."""
    if candidate is None:
        return best
    failed = best.status is RefineStatus.NOT_CONVERGED
    return candidate if failed or candidate.log_posterior > best.log_posterior else best


def _usual_pose_model(rig: Rig) -> PoseModel:
    own = {name.rpartition(".")[2] for name in rig.parameters}
    for pose_model in (PoseModel.AIM_FREE, PoseModel.AIMED):
        if own >= set(pose_model.parameter_names):
            return pose_model
    return PoseModel.RIGID


def _line_observations(matches: MatchedTracks | LineObservations) -> LineObservations:
    check_kind(matches, (MatchedTracks, LineObservations), "set of matches", A_MATCH)
    return matches if isinstance(matches, LineObservations) else matches.line_observations()


def rig_of_tracks(rig: Rig, matches: MatchedTracks | LineObservations) -> Rig:
    """The cameras of the rig that the tracks are of. Raises InputError where it lacks one."""
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
            "There is no track to refine with: match segments of pictures that overlap first."
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
    """The rig with one camera turned about its x and y axes, to either side.

    It is the last of those that moved, or of all where none is named; no start where the sheet
    knows its orientation. One that must stay `aimed` at the origin is taken round it instead.
    """
    name = next(camera for camera in reversed(rig.names) if camera in moved or not moved)
    known_deg = tuning.bundle.known_share * tuning.bundle.turn_deg
    if not moved and (_angle_sigmas_deg(rig, name) < known_deg).all():
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
    return [eqx.tree_at(lambda each: each[name].pose, rig, as_numpy(turned)) for turned in poses]


def _angle_sigmas_deg(rig: Rig, name: str) -> Float[np.ndarray, "3"]:
    """Of pan, tilt and swing, were the camera's lens what the rig says; NaN where not known.

    A lens that is off takes the pose with it, which hides no line from the other cameras.
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
    choice: FreeParameters,
    tuning: CalibTuning,
) -> bool:
    """Whether the best answer is clear of all others that are not the same."""
    return all(
        other.log_posterior * tuning.bundle.clear_factor < best.log_posterior
        or _separation_sigmas(best, other, choice) < tuning.bundle.same_sigmas
        for other in others
        if other is not None
    )


def _separation_sigmas(best: RefineResult, other: RefineResult, choice: FreeParameters) -> float:
    """By how much the tracks that agree with one rig miss each other with the other rig."""
    agree = (best.inlier == best.tracks.seen).all(axis=1) & (best.tracks.seen.sum(axis=1) > 2)
    if not agree.any():
        return 0.0
    squared = squared_distances_with_rig(other.rig, best.tracks, choice)[agree]
    redundancy = 2 * best.tracks.seen[agree].sum(axis=1) - 4
    return float(np.median(np.sqrt(squared.sum(axis=1) / redundancy)))
