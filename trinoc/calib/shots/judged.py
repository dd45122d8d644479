"""From a fitted rig to one judged result."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import information_of
from trinoc.calib.problem.motions import chained, inverse
from trinoc.calib.problem.named_covariance import World, cam_from_world, named_covariance
from trinoc.calib.problem.problem import EndedProblem, Problem, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.shot_scatter import shot_scatter, with_factor
from trinoc.calib.result import Status
from trinoc.calib.shots.cross_validation import cross_validation
from trinoc.calib.shots.determined import determined, open_rows
from trinoc.calib.shots.halves import halves_check
from trinoc.calib.shots.lens_correction import correction_sentences
from trinoc.calib.shots.messages import (
    notes_of_rig,
    refused_sentences,
    silent_sentences,
    undetermined_sentence,
)
from trinoc.calib.shots.placing import PlacedRig
from trinoc.calib.shots.result import RigFromShots
from trinoc.calib.shots.sightings_of_shots import FoundShots
from trinoc.calib.targets import board_names
from trinoc.calib.uncertainty import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import Camera, Intrinsics, Pose, Rig, simplified

# Of the largest sigma: below, there is none.
_EXACT = 1e-12


def judged(
    fit: RobustFit,
    placed: PlacedRig,
    found: FoundShots,
    cameras: tuple[str, ...],
    world: str | None,
    known: Mapping[str, Intrinsics],
    systematics: Systematics,
    *,
    silent: Sequence[tuple[int, int, str]],
    remarks: tuple[str, ...],
    may_give_up: bool,
    throw: bool,
) -> RigFromShots:
    """What the shots determine, in the world asked for, and what to do where that is not all.

    With `may_give_up`, coefficients that the lens's model calls dispensable are held at 0, one
    after the other, where the shots do not determine all.
    """
    place = _world(world, placed, fit.problem, cameras)
    fit, given_up = determined(fit) if may_give_up else (fit, ())
    problem, information = fit.problem, information_of(fit.problem)
    seen = information.seen
    full = seen.rank == len(information.free)
    status = Status.CONVERGED
    if not full:
        status = Status.RANK_DEFICIENT
    elif not fit.converged:
        status = Status.NOT_CONVERGED
    head_covariance = np.nan_to_num(seen.covariance)
    scatter = shot_scatter(information)
    factor = scatter.variance_factor if full else 1.0
    enlarged = with_factor(head_covariance, factor, information.prior)
    named = named_covariance(problem, information, enlarged, factor, cameras, place)
    covariance, is_open = named.covariance, open_rows(problem, information, named.names)
    values = np.array(named.values)
    if not full:
        covariance[is_open], covariance[:, is_open], values[is_open] = np.nan, np.nan, np.nan
    gauge = tuple(name for name, it_is in zip(named.names, is_open) if it_is and not full)
    poses = np.asarray(cam_from_world(problem.state, place))
    rig = None
    if status is Status.CONVERGED:
        rig = _rig(problem, cameras, poses, found, known, named.names, covariance)
    notes = notes_of_rig(fit, cameras, given_up, factor)
    notes = (*remarks, *correction_sentences(problem, cameras), *notes)
    notes = (*notes, *silent_sentences(silent, placed, cameras))
    if status is Status.RANK_DEFICIENT:
        notes = (undetermined_sentence(problem, gauge), *notes)
    elif status is Status.NOT_CONVERGED:
        notes = (f"{status.value} See that all pictures show this board.", *notes)
    base = inverse(chained(inverse(poses[0]), np.asarray(problem.state.cam_from_rig)[0]))
    boards = problem.state.rig_from_board[: problem.shots]
    result = RigFromShots(
        rig=rig,
        status=status,
        parameters=named.names,
        values=values,
        covariance=covariance,
        gauge=gauge,
        world=f"the board {_of_set(problem)}in {placed.shots[place.shot]}"
        if place.shot is not None
        else f"the camera {cameras[place.camera or 0]}",
        target=problem.target,
        cameras=cameras,
        shots=placed.shots,
        reference_from_board=_in_set(problem),
        world_from_board=np.stack([chained(inverse(base), np.asarray(b)) for b in boards]),
        place_shifts_mm=np.asarray(problem.state.shape),
        views=problem.views,
        residuals_px=tuple(errors_px(problem)),
        sigma_factor=dict(zip(cameras, problem.sigma_factor.tolist(), strict=True)),
        reduced_chi_square=fit.chi_square / fit.freedom if fit.freedom > 0 else float("nan"),
        halves=halves_check(problem, cameras, factor) if rig is not None else None,
        cross_validation=cross_validation(problem, cameras) if rig is not None else None,
        ended=EndedProblem(problem, enlarged, factor) if rig is not None else None,
        failures={f"{camera}, {shot}": why for (camera, shot), why in found.failures.items()},
        refused=(*placed.refused, *refused_sentences(fit, placed, cameras)),
        systematics=systematics.words,
        notes=notes,
    )
    if throw and status is not Status.CONVERGED:
        raise CalibrationError(notes[0], {}, result)
    return result


def _world(
    world: str | None, placed: PlacedRig, problem: Problem, cameras: tuple[str, ...]
) -> World:
    """The shot or the camera asked for; the first of the shots that most cameras saw."""
    counts = np.bincount(
        [view.shot for view in problem.views if view.used.any()], minlength=problem.shots
    )
    if world is None:
        return World(int(np.argmax(counts)), None)
    if world in placed.shots:
        shot = placed.shots.index(world)
        if counts[shot]:
            return World(shot, None)
    if world in cameras:
        return World(None, cameras.index(world))
    raise InputError(
        f'The world is to lie in "{world}", which is neither a camera ({", ".join(cameras)}) nor a '
        "shot in which the board was found."
    )


def _in_set(problem: Problem) -> Float[np.ndarray, "b 3 4"]:
    own = np.asarray(problem.state.set_from_board)
    return own if len(own) else np.eye(3, 4)[None]


def _of_set(problem: Problem) -> str:
    """Which board's frame is the set's, in words."""
    names = board_names(problem.target)
    return f'"{names[0]}" ' if len(names) > 1 else ""


def _rig(
    problem: Problem,
    cameras: tuple[str, ...],
    poses: Float[np.ndarray, "c 3 4"],
    found: FoundShots,
    known: Mapping[str, Intrinsics],
    names: tuple[str, ...],
    covariance: Float[np.ndarray, "p p"],
) -> Rig:
    """The cameras, with the covariance of everything that is theirs and was fitted."""
    members = {}
    for number, camera in enumerate(cameras):
        own = int(problem.chart.lens_of_camera[number])
        if camera in known:
            intrinsics = known[camera]
        else:
            lens = lens_number(problem, own)
            size = next(iter(found.detections[camera].values())).image_size_px
            intrinsics = Intrinsics.of_lens(simplified(lens), size)
        members[camera] = Camera(intrinsics, Pose(poses[number]))
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
