"""Notes on a fit to many shots: which of the sentences apply, and to what."""

from collections.abc import Callable, Sequence

import numpy as np

from trinoc.calib import sentences
from trinoc.calib.problem.coefficients import fewest_coefficients, free_of_lenses
from trinoc.calib.problem.lens_correction import correction_sentences
from trinoc.calib.problem.misfit_causes import MisfitCause
from trinoc.calib.problem.named_covariance import NamedCovariance
from trinoc.calib.problem.outcome import FitOutcome
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.status import Status
from trinoc.calib.starts.placing import boards_are_parallel
from trinoc.calib.targets.board_set import board_names, list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.pose import Pose

# Words for a camera's image of a shot, by the numbers of both.
Where = Callable[[int, int], str]


def notes_of_fit(
    fit: RobustFit,
    outcome: FitOutcome,
    gauge: Sequence[str],
    cameras: Sequence[str],
    held: Sequence[str],
    remarks: Sequence[str] = (),
    causes: Sequence[MisfitCause] = (),
    shots: Sequence[str] = (),
) -> tuple[str, ...]:
    """Notes on what is not determined, and on lenses, board and shots.

    gauge : parameters that are not determined. held : coefficients fixed at 0. remarks : sentences
    on the lenses. causes : of large residuals. shots : names.
    """
    problem, notes = fit.problem, []
    if outcome.status is Status.RANK_DEFICIENT:
        prefix = f"{cameras[0]}." if len(cameras) == 1 else ""
        parameters = [name.removeprefix(prefix) for name in gauge]
        notes.append(sentences.shots_do_not_determine(parameters, reason_undetermined(problem)))
    elif outcome.status is Status.NOT_CONVERGED:
        notes.append(sentences.not_converged(outcome.status.value))
    notes += [*remarks, *correction_sentences(problem, cameras)]
    notes += [sentences.cause_of_misfit(cause, cameras, shots) for cause in causes]
    if outcome.variance_factor > 1.0:
        notes.append(sentences.shots_differ(np.sqrt(outcome.variance_factor), bool(causes)))
    if held:
        notes.append(sentences.coefficients_held(held))
    if problem.parametrization.has_circles:
        notes += [
            sentences.circles_of_camera_scatter(camera, factor)
            for camera, factor in zip(cameras, problem.sigma_factor, strict=True)
            if factor > np.sqrt(2.0)
        ]
    poses = [cam_from_board(problem.state, view) for view in problem.views if view.used.any()]
    if poses and np.mean([p.rotation[:, 2] @ p.translation_mm > 0 for p in poses]) > 0.5:
        notes.append(sentences.SEEN_FROM_BEHIND)
    shape = np.asarray(problem.state.shape)
    if len(shape):
        aside_mm, off_plane_mm = (
            float(np.sqrt(np.mean(part**2))) for part in (shape[:, :2], shape[:, 2])
        )
        notes.append(sentences.board_shape(aside_mm, off_plane_mm))
    return (*notes, *_deviations_of_board(problem))


def reason_undetermined(problem: Problem) -> str:
    """Why the shots do not determine all parameters, as a phrase of `sentences`."""
    used = [view for view in problem.views if view.used.any()]
    shots = {view.shot for view in used}
    if len(shots) == 1:
        return sentences.ONE_SHOT
    facing = np.array([cam_from_board(problem.state, view).rotation[:, 2] for view in used])
    tilts_deg = np.degrees(np.arccos(np.clip(np.abs(facing[:, 2]), 0.0, 1.0)))
    parallel_deg = problem.tuning.starts.parallel_deg
    if max(tilts_deg) < parallel_deg:
        return sentences.SQUARE_TO_THE_CAMERA
    boards = [Pose(np.asarray(problem.state.rig_from_board)[shot]) for shot in shots]
    if not len(problem.state.set_from_board) and boards_are_parallel(boards, tuning=problem.tuning):
        return sentences.PARALLEL_BOARDS
    tilted = facing[tilts_deg >= parallel_deg, :2]
    doubled = 2.0 * np.arctan2(tilted[:, 1], tilted[:, 0])
    alignment = np.hypot(np.mean(np.cos(doubled)), np.mean(np.sin(doubled)))
    if problem.cameras == 1 and alignment > np.cos(np.radians(2.0 * parallel_deg)):
        return sentences.ONE_AXIS
    return sentences.MORE_SHOTS


def list_refusals(fit: RobustFit, where: Where) -> tuple[str, ...]:
    """Images that show the board elsewhere, and numbers of corners located wrongly."""
    refusals = [
        sentences.board_elsewhere(where(camera, shot), miss_px)
        for camera, shot, miss_px in fit.elsewhere
    ]
    elsewhere = {(camera, shot) for camera, shot, _ in fit.elsewhere}
    for view in fit.problem.views:
        wrong = int((~view.used).sum())
        if wrong and (view.camera, view.shot) not in elsewhere:
            place = where(view.camera, view.shot)
            refusals.append(sentences.places_located_wrongly(place, wrong, len(view.used)))
    return tuple(refusals)


def misfit_of_lens(fit: RobustFit, places: str) -> str | None:
    """Why a lens must not be used although its fit ended, or None where it may be.

    places : "circles" or "corners".
    """
    views = fit.problem.views
    total, kept = sum(len(view.used) for view in views), sum(int(view.used.sum()) for view in views)
    if 2 * kept < total:
        return sentences.few_places_agree(places, kept, total)
    errors = [each[view.used] for view, each in zip(views, errors_px(fit.problem), strict=True)]
    misfit_px = float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))
    extent_px = np.median([np.ptp(view.detection.centres_px, axis=0).max() for view in views])
    tuning = fit.problem.tuning.answer
    if misfit_px > max(tuning.least_misfit_px, tuning.misfit_share_of_lens * float(extent_px)):
        return sentences.places_misfit(places, misfit_px)
    return None


def notes_of_lens(problem: Problem, camera: str, named: NamedCovariance) -> tuple[str, ...]:
    """Notes on the distortion of the only lens: too many coefficients, corners not reached."""
    lens, notes = lens_number(problem, 0), []
    rows = [named.names.index(f"{camera}.{name}") for name in lens.parameter_names]
    covariance = named.covariance[np.ix_(rows, rows)]
    variance = dict(zip(lens.parameter_names, np.diag(covariance), strict=True))
    names = lens.coefficient_names
    coefficients = [name for name in names if variance[name] > 0]
    if not coefficients or not free_of_lenses(problem).any():
        return ()
    if not isinstance(lens, AbstractSplinedLens):
        count, gain = fewest_coefficients(lens, coefficients, covariance)
        extra = [name for name in coefficients if name not in names[:count]]
        if extra:
            notes.append(sentences.coefficients_not_called_for(count, names, extra, gain))
    reach = _share_reached(problem)
    if reach < problem.tuning.answer.enough_reach:
        place = "circle" if isinstance(problem.target, Pattern) else "corner"
        notes.append(sentences.distortion_extrapolated(place, reach))
    return tuple(notes)


def _share_reached(problem: Problem) -> float:
    """Farthest observation from the principal point, as a share of the way to the corners."""
    observed_px = np.concatenate([view.detection.centres_px for view in problem.views])
    middle = np.asarray(lens_number(problem, 0).principal_point_px)
    width, height = problem.image_sizes_px[0]
    corners_px = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    reach, farthest = (
        np.linalg.norm(pixels - middle, axis=1).max() for pixels in (observed_px, corners_px)
    )
    return float(reach / farthest)


def _deviations_of_board(problem: Problem) -> list[str]:
    """Notes on parameters of the board that are far from what was stated."""
    information = np.asarray(problem.priors.sheet_information)
    free = np.flatnonzero(np.diag(information) > 0)
    sigmas = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(free, free)])))
    several, terms = len(list_boards(problem.target)) > 1, problem.parametrization.sheet_model.names
    names = [(board, term) for board in board_names(problem.target) for term in terms]
    notes = []
    for row, value, sigma in zip(free, np.asarray(problem.state.sheet)[free], sigmas, strict=True):
        board, term = names[row]
        if abs(value) > problem.tuning.answer.strain_sigmas * sigma:
            strain = abs(value) / sigma
            notes.append(sentences.board_deviates(board if several else "", term, value, strain))
    return notes
