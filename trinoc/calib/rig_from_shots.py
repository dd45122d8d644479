"""From the fit to many shots to the rig that it ended with, and the shot that it lacks most."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.advice.halves import compare_halves, cross_validate
from trinoc.calib.advice.next_shot import NextShot, advise_next_shot
from trinoc.calib.folded_lens import FoldFindings, assess_folds, observed_pixels
from trinoc.calib.problem.misfit_causes import find_causes
from trinoc.calib.problem.named_covariance import (
    World,
    named_covariance,
    open_rows,
    poses_in_world,
)
from trinoc.calib.problem.outcome import assess_fit
from trinoc.calib.problem.problem import EndedProblem, Problem, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.refutations import HeldLenses, say_strained_lens
from trinoc.calib.result.calibration import Status
from trinoc.calib.shot_messages import (
    list_refusals,
    notes_of_fit,
    scatter_sentence,
    silent_sentences,
)
from trinoc.calib.shots_result import RigFromShots
from trinoc.calib.targets.board_set import board_names
from trinoc.calib.tuning.every_group import TUNING
from trinoc.errors import InputError, check_kind, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import simplify_lens
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.numerics.precision import in_float64

# numerical: of the largest sigma: below, there is none.
_EXACT = 1e-12


@in_float64
def next_shot(result: RigFromShots) -> NextShot | None:
    """The shot that lowers most what the rig errs by where it errs most, over all cameras.

    Compared are shots of the board in nine places of each camera's picture, at two distances, and
    tilted in four ways or not, seen by every camera in whose picture it then lies. None where it
    lies in no picture. Raises InputError for a result that did not converge.
    """
    check_kind(result, RigFromShots, "result", "what calibrate_rig returns")
    end = result.ended
    if end is None:
        raise InputError(f"There is no rig that a shot could be added to: {result.status.value}")
    board = Pose(np.asarray(end.problem.state.rig_from_board)[0])
    world_from_rig = Pose(result.world_from_board[0]) @ board.inverse
    return advise_next_shot(
        end.problem, end.covariance, end.variance_factor, result.cameras, world_from_rig
    )


def result_from_fit(
    fit: RobustFit,
    shots: tuple[str, ...],
    cameras: tuple[str, ...],
    known: Mapping[str, Intrinsics],
    *,
    world: str | None,
    held: tuple[str, ...],
    remarks: tuple[str, ...],
    silent: Sequence[tuple[int, int, str]],
    refused: tuple[str, ...],
    failures: dict[str, str],
    systematics: tuple[str, ...],
) -> RigFromShots:
    """What the shots determine, in the world that is called for, and why where that is not all.

    known : lenses that were given. held : coefficients that were given up. remarks, refused,
    failures, systematics : as `RigFromShots` has them. silent : pictures whose points count.
    """
    problem, outcome = fit.problem, assess_fit(fit)
    place = _choose_world(world, shots, problem, cameras)
    status, information, enlarged, factor = outcome
    good, said = status is Status.CONVERGED, None
    folds = FoldFindings(None, ())
    if good:
        observed_px = {
            name: observed_pixels(problem.views, camera) for camera, name in enumerate(cameras)
        }
        folds = assess_folds(_lenses(problem, cameras, known), observed_px)
    if folds.failure is not None:
        good, said, status = False, folds.failure, Status.SUSPECT
    if good:
        lenses, said = HeldLenses.of(fit, cameras), say_strained_lens(problem, cameras)
        said = said or (lenses and lenses.say_what_is_refuted())
        status = Status.CONVERGED if said is None else Status.SUSPECT
        said = said or (lenses and lenses.say_what_goes_unseen(enlarged))
    named = named_covariance(problem, information, enlarged, factor, cameras, place)
    covariance, values, gauge = named.covariance, np.array(named.values), ()
    if status is Status.RANK_DEFICIENT:
        is_open = open_rows(problem, information, named.names)
        covariance[is_open], covariance[:, is_open], values[is_open] = np.nan, np.nan, np.nan
        gauge = tuple(name for name, it_is in zip(named.names, is_open) if it_is)

    def where(camera: int, shot: int) -> str:
        return f'{shots[shot]}: "{cameras[camera]}"'

    causes = find_causes(problem) if good else []
    factors = dict(zip(cameras, problem.sigma_factor.tolist(), strict=True))
    worst, scatter = max(factors, key=lambda camera: factors[camera]), None
    if good and factors[worst] > TUNING.answer.largest_sigma_factor:
        status = Status.SUSPECT
        scatter = scatter_sentence(worst, factors[worst], bool(causes))
    notes = [
        *filter(None, [scatter, said]),
        *notes_of_fit(fit, outcome, gauge, cameras, held, (*remarks, *folds.notes), causes, shots),
    ]
    poses = [Pose(pose) for pose in np.asarray(poses_in_world(problem.state, place)[0])]
    world_from_rig = poses[0].inverse @ Pose(np.asarray(problem.state.cam_from_rig)[0])
    boards = np.asarray(problem.state.rig_from_board)[: problem.shots]
    fixed, members = np.asarray(problem.state.set_from_board), board_names(problem.target)
    which = f'"{members[0]}" ' if len(members) > 1 else ""
    return RigFromShots(
        rig=_rig(problem, cameras, poses, known, named.names, covariance) if good else None,
        status=status,
        parameters=named.names,
        values=values,
        covariance=covariance,
        gauge=gauge,
        world=f"the board {which}in {shots[place.shot]}"
        if place.shot is not None
        else f"the camera {cameras[place.camera or 0]}",
        target=problem.target,
        cameras=cameras,
        shots=shots,
        reference_from_board=fixed if len(fixed) else np.eye(3, 4)[None],
        world_from_board=np.stack([(world_from_rig @ Pose(b)).cam_from_world for b in boards]),
        place_shifts_mm=np.asarray(problem.state.shape),
        views=problem.views,
        residuals_px=tuple(errors_px(problem)),
        sigma_factor=factors,
        reduced_chi_square=fit.chi_square / fit.freedom if fit.freedom > 0 else float("nan"),
        halves=compare_halves(problem, cameras, factor) if good else None,
        cross_validation=cross_validate(problem, cameras) if good else None,
        ended=EndedProblem(problem, enlarged, factor) if good else None,
        failures=failures,
        refused=(*refused, *list_refusals(fit, where)),
        systematics=systematics,
        notes=(*notes, *silent_sentences(silent, where)),
    )


def _choose_world(
    world: str | None, shots: tuple[str, ...], problem: Problem, cameras: tuple[str, ...]
) -> World:
    """The shot or the camera of this name; else the first of the shots that most cameras saw."""
    counts = np.bincount(
        [view.shot for view in problem.views if view.used.any()], minlength=problem.shots
    )
    if world is None:
        return World(np.asarray(np.argmax(counts)), None)
    if world in shots and counts[shots.index(world)]:
        return World(np.asarray(shots.index(world)), None)
    if world in cameras:
        return World(None, np.asarray(cameras.index(world)))
    raise InputError(
        f'The world is to lie in "{world}", which is neither a camera ({list_names(cameras)}) '
        "nor a shot in which the board was found."
    )


def _lenses(
    problem: Problem, cameras: tuple[str, ...], known: Mapping[str, Intrinsics]
) -> dict[str, Intrinsics]:
    """Lens of each camera: the given one, or the fitted one."""
    sizes, lenses = problem.image_sizes_px, {}
    for number, camera in enumerate(cameras):
        lens = lens_number(problem, int(problem.parametrization.lens_of_camera[number]))
        own = Intrinsics.of_lens(simplify_lens(lens), sizes[number])
        lenses[camera] = known.get(camera) or own
    return lenses


def _rig(
    problem: Problem,
    cameras: tuple[str, ...],
    cam_from_world: Sequence[Pose],
    known: Mapping[str, Intrinsics],
    names: tuple[str, ...],
    covariance: Float[np.ndarray, "p p"],
) -> Rig:
    """The cameras, with the covariance of everything that is theirs and was fitted."""
    lenses = _lenses(problem, cameras, known)
    members = {
        camera: Camera(lens, pose)
        for (camera, lens), pose in zip(lenses.items(), cam_from_world, strict=True)
    }
    # What is held, and the pose of a camera that is the world, has the variance of rounding.
    sigma = np.sqrt(np.diag(covariance))
    kept = [
        k
        for k, name in enumerate(names)
        if not name.startswith("board.") and sigma[k] > _EXACT * max(float(sigma.max()), 1e-300)
    ]
    return Rig(
        members, parameters=[names[k] for k in kept], covariance=covariance[np.ix_(kept, kept)]
    )
