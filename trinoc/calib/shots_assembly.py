"""Public result of a calibration from many shots: status, and `CalibrationResult`."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib import sentences
from trinoc.calib.advice.halves import compare_halves, cross_validate
from trinoc.calib.advice.next_shot import covariance_with_weak_prior
from trinoc.calib.folded_lens import FoldFindings, assess_folds, observed_pixels
from trinoc.calib.problem.misfit_causes import find_causes
from trinoc.calib.problem.named_covariance import (
    NamedCovariance,
    World,
    named_covariance,
    poses_in_world,
    undetermined_rows,
)
from trinoc.calib.problem.outcome import FitOutcome, assess_fit
from trinoc.calib.problem.problem import Problem, SolvedProblem, lens_of_index
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, whitened_errors
from trinoc.calib.problem.status import Status
from trinoc.calib.refutations import ExactLensTests, describe_strained_lens
from trinoc.calib.result.calibration import CalibrationResult, CameraFit
from trinoc.calib.shot_notes import list_refusals, notes_of_fit, notes_of_lens
from trinoc.calib.shots_fit import ShotObservations, ShotsFit
from trinoc.calib.starts.pictures import BoardDetections
from trinoc.calib.targets.board_set import board_names
from trinoc.errors import InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.registry import simplify_lens
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig

# numerical: a sigma below this share of the largest one is rounding.
_EXACT = 1e-12


def result_of_shots(
    shots_fit: ShotsFit,
    boards: BoardDetections,
    observations: ShotObservations,
    exact_lenses: Mapping[str, Intrinsics],
    *,
    world: str | None,
    method: str = "points",
    pixel_pitch_mm: tuple[float, float] | None = None,
    is_lens: bool = False,
) -> CalibrationResult:
    """Decide the status of a fit to many shots, and assemble its public result.

    Parameters
    ----------
    shots_fit : the fit.
    boards : detections of the board, with the images that failed.
    observations : input of the fit.
    exact_lenses : intrinsics of the cameras whose lens was given as exact.
    world : name of the shot or camera that defines the world; None for the shot that most cameras
        saw.
    method : "points" or "pixels".
    pixel_pitch_mm : pixel pitch of every fitted lens.
    is_lens : whether the result is a single lens. Halves of the shots are then not compared.

    Raises
    ------
    InputError : `world` is neither a camera nor a shot.
    """
    fit, cameras, shots = shots_fit.fit, observations.cameras, shots_fit.initial_rig.shots
    problem, outcome = fit.problem, assess_fit(fit)
    world_frame = _choose_world(world, shots, problem, cameras)
    lenses = _fitted_lenses(problem, cameras, pixel_pitch_mm) | dict(exact_lenses)
    status, suspect_reason, lens_warning = outcome.status, None, None
    is_determined, folds = status is Status.CONVERGED, FoldFindings(None, ())
    if is_determined:
        pixels = {name: observed_pixels(problem.views, k) for k, name in enumerate(cameras)}
        folds = assess_folds(lenses, pixels)
    if folds.failure is not None:
        is_determined, status, suspect_reason = False, Status.SUSPECT, folds.failure
    if is_determined:
        exact_lens_tests = ExactLensTests.of(fit, cameras)
        suspect_reason = describe_strained_lens(problem, cameras)
        if exact_lens_tests is not None:
            suspect_reason = suspect_reason or exact_lens_tests.describe_refuted_lens()
            lens_warning = exact_lens_tests.describe_undetectable_error(outcome.covariance)
        status = Status.CONVERGED if suspect_reason is None else Status.SUSPECT
    causes = find_causes(problem) if is_determined else []
    factors = dict(zip(cameras, problem.sigma_factor.tolist(), strict=True))
    worst, scatter_warning = max(factors, key=lambda camera: factors[camera]), None
    if is_determined and factors[worst] > problem.tuning.answer.largest_sigma_factor:
        status = Status.SUSPECT
        scatter_warning = sentences.residuals_exceed_sigmas(worst, factors[worst], bool(causes))
    named, gauge = _named_with_gauge(problem, outcome, cameras, world_frame)

    def image_name(camera: int, shot: int) -> str:
        return shots[shot] if len(cameras) == 1 else f'{shots[shot]}: "{cameras[camera]}"'

    remarks = (*boards.remarks, *shots_fit.remarks, *folds.notes)
    notes = [
        # A lens that the shots contradict makes the undetectable error of another one irrelevant.
        *filter(None, [scatter_warning, suspect_reason or lens_warning]),
        *notes_of_fit(
            fit, outcome, gauge, cameras, shots_fit.fixed_coefficients, remarks, causes, shots
        ),
    ]
    if len(cameras) == 1 and is_determined:
        notes += notes_of_lens(problem, cameras[0], named)
    residuals_px = tuple(errors_px(problem))
    poses = [Pose(pose) for pose in np.asarray(poses_in_world(problem.state, world_frame)[0])]
    world_from_rig = poses[0].inverse @ Pose(np.asarray(problem.state.cam_from_rig)[0])
    rig_from_board = np.asarray(problem.state.rig_from_board)[: problem.shots]
    set_from_board = np.asarray(problem.state.set_from_board)
    failures = {f"{camera}, {shot}": reason for (camera, shot), reason in boards.failures.items()}
    return CalibrationResult(
        solution=_rig(lenses, poses, named) if is_determined else None,
        status=dict.fromkeys(cameras, status),
        parameters=named.names,
        values=named.values,
        covariance=named.covariance,
        fits=_camera_fits(fit, cameras, residuals_px, named, gauge, method),
        target=problem.target,
        failures=failures,
        systematics=observations.systematics.descriptions,
        notes=(
            *notes,
            *(
                sentences.grey_levels_not_used(image_name(camera, shot), reason)
                for camera, shot, reason in shots_fit.images_without_grey_levels
            ),
        ),
        gauge=gauge,
        reduced_chi_square=fit.chi_square / fit.freedom if fit.freedom > 0 else float("nan"),
        refused=(
            *shots_fit.initial_rig.refused,
            *_remarks_on_detections(boards),
            *list_refusals(fit, image_name),
        ),
        world=_describe_world(world_frame, problem, shots, cameras),
        shots=shots,
        world_from_board=np.stack(
            [(world_from_rig @ Pose(board)).cam_from_world for board in rig_from_board]
        ),
        reference_from_board=set_from_board if len(set_from_board) else np.eye(3, 4)[None],
        place_shifts_mm=np.asarray(problem.state.shape),
        views=problem.views,
        residuals_px=residuals_px,
        halves=compare_halves(problem, cameras, outcome.variance_factor)
        if is_determined and not is_lens
        else None,
        cross_validation=cross_validate(problem, cameras)
        if is_determined and not is_lens
        else None,
        solved_problem=_solved_problem(problem, outcome),
        is_lens=is_lens,
    )


def _solved_problem(problem: Problem, outcome: FitOutcome) -> SolvedProblem | None:
    """Problem with its covariance, for the prediction of the next shot; None if the fit failed."""
    if outcome.status is Status.NOT_CONVERGED:
        return None
    if outcome.status is Status.CONVERGED:
        return SolvedProblem(problem, outcome.covariance, outcome.variance_factor)
    return SolvedProblem(problem, covariance_with_weak_prior(outcome.information), 1.0)


def _named_with_gauge(
    problem: Problem, outcome: FitOutcome, cameras: tuple[str, ...], world_frame: World
) -> tuple[NamedCovariance, tuple[str, ...]]:
    """Public parameters with their covariance, and the names of the undetermined ones.

    Undetermined values and covariances are NaN.

    outcome : status and covariance of the fit. world_frame : reference frame of the poses.
    """
    information = outcome.information
    named = named_covariance(
        problem, information, outcome.covariance, outcome.variance_factor, cameras, world_frame
    )
    values, covariance = np.array(named.values), named.covariance
    if outcome.status is Status.NOT_CONVERGED:
        return named._replace(values=np.full_like(values, np.nan)), ()
    if outcome.status is not Status.RANK_DEFICIENT:
        return named, ()
    is_open = undetermined_rows(problem, information, named.names, world_frame)
    covariance[is_open], covariance[:, is_open], values[is_open] = np.nan, np.nan, np.nan
    gauge = tuple(name for name, is_undetermined in zip(named.names, is_open) if is_undetermined)
    return NamedCovariance(named.names, values, covariance), gauge


def _camera_fits(
    fit: RobustFit,
    cameras: tuple[str, ...],
    residuals_px: Sequence[Float[np.ndarray, "_m 2"]],
    named: NamedCovariance,
    gauge: Sequence[str],
    method: str,
) -> dict[str, CameraFit]:
    """Public fit of each camera, over all its shots, by the name of the camera.

    residuals_px : residuals of each observation. named : covariance of the public parameters.
    gauge : names of undetermined parameters.
    """
    problem, fits, sigma = fit.problem, {}, np.sqrt(np.diag(named.covariance))
    chi_square = np.sum(whitened_errors(problem)[: len(problem.views)] ** 2, axis=(1, 2))
    coordinates = np.array([view.coordinate_count for view in problem.views])
    # Each camera has a share of the degrees of freedom by its number of coordinates.
    freedom = coordinates * (max(fit.freedom, 0) / max(int(coordinates.sum()), 1))
    least_sigma = _EXACT * np.nanmax(sigma, initial=0.0)
    for camera_index, camera in enumerate(cameras):
        rows = [k for k, view in enumerate(problem.views) if view.camera == camera_index]
        residuals = [np.zeros((0, 2)), *(residuals_px[k] for k in rows)]
        used = [np.zeros(0, dtype=bool), *(problem.views[k].rows_used for k in rows)]
        prefix, total = f"{camera}.", float(freedom[rows].sum())
        is_of_camera = np.array([name.rpartition(".")[0] == camera for name in named.names])
        fits[camera] = CameraFit(
            residuals_px=np.concatenate(residuals),
            used=np.concatenate(used),
            rank=int(np.sum(is_of_camera & np.isfinite(sigma) & (sigma > least_sigma))),
            reduced_chi_square=float(chi_square[rows].sum()) / total if total > 0 else float("nan"),
            gauge=tuple(name.removeprefix(prefix) for name in gauge if name.startswith(prefix)),
            sigma_factor=float(problem.sigma_factor[camera_index]),
            method=method,
        )
    return fits


def _remarks_on_detections(boards: BoardDetections) -> list[str]:
    """Return one sentence for each image in which the detector rejected some corners or circles."""
    is_one = len(boards.detections) == 1
    return [
        sentences.detection_remark(shot if is_one else f'{shot}: "{camera}"', remark)
        for camera, detections in boards.detections.items()
        for shot, detection in detections.items()
        for remark in detection.remarks
    ]


def _choose_world(
    world: str | None, shots: tuple[str, ...], problem: Problem, cameras: tuple[str, ...]
) -> World:
    """World frame from the name of a shot or camera.

    Default: the first of the shots that most cameras saw. Raises `InputError` for another name.
    """
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
        f'world is "{world}", but must be a camera ({list_names(cameras)}) or a shot in which '
        "the board was found."
    )


def _describe_world(
    world_frame: World, problem: Problem, shots: tuple[str, ...], cameras: tuple[str, ...]
) -> str:
    if world_frame.shot is None:
        return f"the camera {cameras[int(world_frame.camera or 0)]}"
    names = board_names(problem.target)
    board_name = f'"{names[0]}" ' if len(names) > 1 else ""
    return f"the board {board_name}in {shots[int(world_frame.shot)]}"


def _fitted_lenses(
    problem: Problem, cameras: tuple[str, ...], pixel_pitch_mm: tuple[float, float] | None
) -> dict[str, Intrinsics]:
    sizes, lenses = problem.image_sizes_px, {}
    for camera_index, camera in enumerate(cameras):
        lens = lens_of_index(problem, int(problem.parametrization.lens_of_camera[camera_index]))
        lenses[camera] = Intrinsics.of_lens(
            simplify_lens(lens), sizes[camera_index], pixel_pitch_mm
        )
    return lenses


def _rig(
    lenses: Mapping[str, Intrinsics], cam_from_world: Sequence[Pose], named: NamedCovariance
) -> Rig:
    """Rig with the covariance of all estimated lens and pose parameters."""
    members = {
        camera: Camera(lens, pose)
        for (camera, lens), pose in zip(lenses.items(), cam_from_world, strict=True)
    }
    # Fixed parameters, and the pose of a camera that is the world, have variances of rounding only.
    sigma = np.sqrt(np.diag(named.covariance))
    rows = [
        k
        for k, name in enumerate(named.names)
        if not name.startswith("board.") and sigma[k] > _EXACT * max(float(sigma.max()), 1e-300)
    ]
    names = [named.names[k] for k in rows]
    return Rig(members, parameters=names, covariance=named.covariance[np.ix_(rows, rows)])
