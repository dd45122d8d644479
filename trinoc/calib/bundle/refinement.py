"""Refine a rig jointly against the sheet it was calibrated with and segments matched by it."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple, Protocol, runtime_checkable

from trinoc.calib.bundle.estimate import joint_estimate
from trinoc.calib.bundle.multi_start import is_unambiguous, start_rigs
from trinoc.calib.bundle.problem import FreeParameters
from trinoc.calib.bundle.result import RefineResult, RefineStatus
from trinoc.calib.result import CalibrationResult
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import AFFINE_PARAMETERS, LineObservations, PoseModel, Rig
from trinoc.numerics import in_float64

MOST_ROUNDS = 8


@runtime_checkable
class Matched(Protocol):
    """Anything that holds tracks of fragments, as the matcher's answer does."""

    def line_observations(self) -> LineObservations:
        """The tracks as observations of lines."""
        ...


Matcher = Callable[[Rig], Matched | LineObservations]


@in_float64
def refine(
    calibrated: CalibrationResult | Rig,
    matches: Matched | LineObservations,
    *,
    pose_model: PoseModel | str | None = None,
    intrinsics: bool | None = None,
    moved: Collection[str] = (),
    match_again: Matcher | Sequence[Matcher] | None = None,
    start: Rig | None = None,
) -> RefineResult:
    """Cameras and 3-D lines of maximum likelihood, given a sheet's calibration and matches.

    `calibrated` is the result of a calibration, or a rig. A covariance of the rig is used as a
    Gaussian prior. Without one the gauge (position, orientation and scale of the rig) is held,
    and reported in `gauge`. `pose_model` is what may move in each camera: by default what the
    covariance names, and any rigid motion without one. `intrinsics` frees focal lengths and
    principal points too: by default those that the covariance names, each with what it says.
    `moved` names cameras that were knocked since: the prior no longer holds for them, and they
    need not aim at the sheet's origin any more.
    `match_again`, for example `lambda rig: trinoc.match_segments(segments, rig)`, is called
    with each refined rig until the tracks stop changing; a round that lowers the log posterior
    is not accepted. After a large knock give several, the most tolerant first (a larger
    `sigma_px`): each refines the rig for the next, and the last decides.

    `start` is where the cameras start from, where that is not where the sheet placed them.

    Raises InputError where matches and rig do not belong together, CalibrationError where no
    track is left.
    """
    rig = calibrated.rig if isinstance(calibrated, CalibrationResult) else calibrated
    unknown = sorted(set(moved) - set(rig.names))
    if unknown:
        raise InputError(
            f"There is no camera {', '.join(unknown)} that could have moved; this rig has "
            f"{', '.join(rig.names)}."
        )
    trusted = tuple(name for name in rig.names if name not in moved)
    usual = _pose_model_of(rig)
    chosen = None if pose_model is None else PoseModel.of(pose_model)
    # A knocked camera need not aim at the origin of the sheet any more.
    knocked = bool(moved) and chosen is None and usual is PoseModel.AIMED
    model = PoseModel.AIM_FREE if knocked else chosen or usual
    lens_is_open = any(name.rpartition(".")[2] in AFFINE_PARAMETERS for name in rig.parameters)
    free_lens = lens_is_open if intrinsics is None else intrinsics
    choice = FreeParameters(model, free_lens, trusted, knocked, lens_held=intrinsics is None)
    task = _Task(calibrated, rig, choice)
    first = task.refined(start or rig, matches)
    if match_again is None:
        return first
    matchers = [match_again] if callable(match_again) else list(match_again)
    best = task.settled(first, matchers[-1])
    if len(matchers) > 1:
        best = task.better(best, task.from_start(rig, matchers))
    turned = start_rigs(rig, moved, choice.pose_model)
    others = [task.from_start(start, matchers) for start in turned]
    for other in others:
        best = task.better(best, other)
    if others and not is_unambiguous(best, others, choice):
        return dataclasses.replace(best, status=RefineStatus.AMBIGUOUS, rig=rig)
    return best


class _Task(NamedTuple):
    """What stays the same over all rounds of one refinement."""

    calibrated: CalibrationResult | Rig
    sheet_rig: Rig
    choice: FreeParameters

    def refined(self, rig: Rig, matches: Matched | LineObservations) -> RefineResult:
        lines = _observations(matches, rig)
        return joint_estimate(rig, self.sheet_rig, lines, self.choice, self.calibrated)

    def matched_again(self, rig: Rig, match: Matcher) -> RefineResult | None:
        """The refinement from what is found with a rig; None where that leads nowhere."""
        matches = match(rig)
        lines = matches if isinstance(matches, LineObservations) else matches.line_observations()
        if len(lines) == 0:
            return None
        result = self.refined(rig, lines)
        return None if result.status is RefineStatus.NOT_CONVERGED else result

    def from_start(self, rig: Rig, matchers: Sequence[Matcher]) -> RefineResult | None:
        """The most probable rig that the matchers lead to, one after the other."""
        result = None
        for match in matchers:
            result = self.matched_again(rig, match)
            if result is not None:
                result = self.settled(result, match)
                rig = result.rig
        return result

    def better(self, best: RefineResult, candidate: RefineResult | None) -> RefineResult:
        if candidate is None or (
            best.status is not RefineStatus.NOT_CONVERGED
            and candidate.log_posterior <= best.log_posterior
        ):
            return best
        return candidate

    def settled(self, best: RefineResult, match: Matcher) -> RefineResult:
        """Matched and refined again while that is more probable than what was before."""
        history = [best.log_posterior]
        if best.status is RefineStatus.NOT_CONVERGED:
            return best
        for _ in range(MOST_ROUNDS):
            candidate = self.matched_again(best.rig, match)
            # A hundredth is what a refinement leaves to its stopping rule.
            if candidate is None or candidate.log_posterior < best.log_posterior + 0.01:
                break
            best = candidate
            history.append(best.log_posterior)
        return dataclasses.replace(best, history=tuple(history))


def _pose_model_of(rig: Rig) -> PoseModel:
    own = {name.rpartition(".")[2] for name in rig.parameters}
    for pose_model in (PoseModel.AIM_FREE, PoseModel.AIMED):
        if own >= set(pose_model.parameter_names):
            return pose_model
    return PoseModel.RIGID


def _observations(matches: Matched | LineObservations, rig: Rig) -> LineObservations:
    lines = matches if isinstance(matches, LineObservations) else matches.line_observations()
    if set(lines.views) != set(rig.names):
        raise InputError(
            f"The matches are of the views {', '.join(lines.views)}, but the rig has the cameras "
            f"{', '.join(rig.names)}: give the rig that these matches were made with."
        )
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
