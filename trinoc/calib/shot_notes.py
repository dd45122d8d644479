"""Selection of the sentences for a fit to many shots."""

from collections.abc import Callable, Sequence

import numpy as np

from trinoc.calib import sentences
from trinoc.calib.problem.coefficients import fewest_coefficients, free_of_lenses
from trinoc.calib.problem.lens_correction import measure_corrections
from trinoc.calib.problem.misfit_causes import MisfitCause
from trinoc.calib.problem.named_covariance import NamedCovariance
from trinoc.calib.problem.outcome import FitOutcome
from trinoc.calib.problem.problem import Problem, cam_from_board, lens_of_index
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.status import Status
from trinoc.calib.starts.placing import boards_are_parallel
from trinoc.calib.targets.board_set import board_names, list_boards
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.pose import Pose

# Name of an image for the user, from the numbers of its camera and its shot.
ImageName = Callable[[int, int], str]


def notes_of_fit(
    fit: RobustFit,
    outcome: FitOutcome,
    gauge: Sequence[str],
    cameras: Sequence[str],
    fixed_coefficients: Sequence[str],
    remarks: Sequence[str] = (),
    causes: Sequence[MisfitCause] = (),
    shots: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return the notes on a fit to many shots: undetermined parameters, lenses, board and shots.

    Parameters
    ----------
    fit, outcome : the fit, with its status and covariance.
    gauge : names of undetermined parameters.
    cameras : names of the cameras.
    fixed_coefficients : names of distortion coefficients that were fixed at 0.
    remarks : notes on the lenses.
    causes : causes of large residuals.
    shots : names of the shots.
    """
    problem, notes = fit.problem, []
    if outcome.status is Status.RANK_DEFICIENT:
        prefix = f"{cameras[0]}." if len(cameras) == 1 else ""
        parameters = [name.removeprefix(prefix) for name in gauge]
        notes.append(sentences.shots_do_not_determine(parameters, reason_undetermined(problem)))
    elif outcome.status is Status.NOT_CONVERGED:
        notes.append(sentences.not_converged(outcome.status.value))
    notes += remarks
    for correction in measure_corrections(problem):
        lens_of_camera = problem.parametrization.lens_of_camera
        camera = cameras[int(np.flatnonzero(np.asarray(lens_of_camera) == correction.lens)[0])]
        notes.append(sentences.lens_corrected(correction, camera))
    notes += [sentences.cause_of_misfit(cause, cameras, shots) for cause in causes]
    if outcome.variance_factor > 1.0:
        notes.append(sentences.shots_differ(np.sqrt(outcome.variance_factor), bool(causes)))
    if fixed_coefficients:
        notes.append(sentences.coefficients_fixed(fixed_coefficients))
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
        in_plane_mm, off_plane_mm = (
            float(np.sqrt(np.mean(component**2))) for component in (shape[:, :2], shape[:, 2])
        )
        notes.append(sentences.board_shape(in_plane_mm, off_plane_mm))
    return (*notes, *_deviations_of_board(problem))


def reason_undetermined(problem: Problem) -> str:
    """Return the reason why the shots do not determine all parameters, with the remedy.

    It is the end of a sentence, one of the constants in `sentences`.
    """
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


def list_refusals(fit: RobustFit, image_name: ImageName) -> tuple[str, ...]:
    """Return one sentence for each rejected image, and for each other image with outliers.

    image_name : function of (camera index, shot index) that returns the name of an image for the
        user.
    """
    refusals = [
        sentences.board_elsewhere(image_name(camera, shot), miss_px)
        for camera, shot, miss_px in fit.rejected_images
    ]
    rejected = {(camera, shot) for camera, shot, _ in fit.rejected_images}
    for view in fit.problem.views:
        outliers = int((~view.used).sum())
        if outliers and (view.camera, view.shot) not in rejected:
            name = image_name(view.camera, view.shot)
            refusals.append(sentences.points_located_wrongly(name, outliers, len(view.used)))
    return tuple(refusals)


def misfit_of_lens(fit: RobustFit, point_kind: str) -> str | None:
    """Return the reason why a fitted lens must not be used, or None if it may be used.

    It must not be used if most points are outliers, or if the residuals are large.

    point_kind : "circles" or "corners".
    """
    views = fit.problem.views
    total, used = sum(len(view.used) for view in views), sum(int(view.used.sum()) for view in views)
    if 2 * used < total:
        return sentences.few_points_agree(point_kind, used, total)
    errors = [
        residuals_px[view.used]
        for view, residuals_px in zip(views, errors_px(fit.problem), strict=True)
    ]
    misfit_px = float(np.sqrt(np.mean(np.sum(np.concatenate(errors) ** 2, axis=1))))
    extent_px = np.median([np.ptp(view.detection.centres_px, axis=0).max() for view in views])
    tuning = fit.problem.tuning.answer
    if misfit_px > max(tuning.least_misfit_px, tuning.misfit_share_of_lens * float(extent_px)):
        return sentences.points_misfit(point_kind, misfit_px)
    return None


def notes_of_lens(problem: Problem, camera: str, named: NamedCovariance) -> tuple[str, ...]:
    """Return the notes on the distortion of a single lens.

    They report coefficients that the residuals do not need, and corners of the image without
    observations.

    camera : name of the camera. named : covariance of the public parameters.
    """
    lens, notes = lens_of_index(problem, 0), []
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
    share = _share_reached(problem)
    if share < problem.tuning.answer.enough_reach:
        point_kind = "circle" if isinstance(problem.target, Pattern) else "corner"
        notes.append(sentences.distortion_extrapolated(point_kind, share))
    return tuple(notes)


def _share_reached(problem: Problem) -> float:
    """Distance from the principal point to the farthest observation, divided by that to the
    farthest corner of the image.
    """
    observed_px = np.concatenate([view.detection.centres_px for view in problem.views])
    middle = np.asarray(lens_of_index(problem, 0).principal_point_px)
    width, height = problem.image_sizes_px[0]
    corners_px = np.array([[0, 0], [width, 0], [0, height], [width, height]]) - 0.5
    observed_distance, corner_distance = (
        np.linalg.norm(pixels - middle, axis=1).max() for pixels in (observed_px, corners_px)
    )
    return float(observed_distance / corner_distance)


def _deviations_of_board(problem: Problem) -> list[str]:
    """Return one warning for each board parameter whose estimate is far from the given value."""
    information = np.asarray(problem.priors.sheet_information)
    free = np.flatnonzero(np.diag(information) > 0)
    sigmas = np.sqrt(np.diag(np.linalg.inv(information[np.ix_(free, free)])))
    is_set, terms = len(list_boards(problem.target)) > 1, problem.parametrization.sheet_model.names
    names = [(board, term) for board in board_names(problem.target) for term in terms]
    notes = []
    for row, value, sigma in zip(free, np.asarray(problem.state.sheet)[free], sigmas, strict=True):
        board, term = names[row]
        if abs(value) > problem.tuning.answer.strain_sigmas * sigma:
            strain = abs(value) / sigma
            notes.append(sentences.board_deviates(board if is_set else "", term, value, strain))
    return notes
