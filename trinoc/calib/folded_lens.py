"""Treatment of fitted lenses that fold the image: their distortion maps two rays to one pixel.

A lens folds the image where no board was observed, because its distortion is extrapolated there.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib import sentences
from trinoc.calib.problem.coefficients import free_of_lenses
from trinoc.calib.problem.moments import errors_about_image_poses_px, fit_image_poses
from trinoc.calib.problem.outcome import assess_fit
from trinoc.calib.problem.problem import Problem, lens_of_index, with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, refit
from trinoc.calib.problem.status import Status
from trinoc.calib.problem.views import BoardObservation
from trinoc.errors import CalibrationError
from trinoc.geometry.intrinsics import Intrinsics, describe_fold, describe_usable_fold
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.kannala_brandt import KannalaBrandt
from trinoc.geometry.lenses.polynomial import Rational
from trinoc.geometry.lenses.registry import simplify_lens

if TYPE_CHECKING:
    from trinoc.calib.shots_fit import ShotsFit

# Models that follow a strong distortion without folding the image. The first one is OpenCV's own
# with eight coefficients, which undistorts by the same functions as Brown-Conrady's.
_WIDER_MODELS: tuple[type[AbstractLens], ...] = (Rational, KannalaBrandt)


class FoldFindings(NamedTuple):
    """Result of the check whether fitted lenses fold their images.

    A lens folds the image where its distortion maps two rays to one pixel.

    Attributes
    ----------
    failure : error for the first lens that must not be used, with the remedy; None if all may be
        used.
    notes : note on each lens that folds the image only where nothing was observed.
    """

    failure: str | None
    notes: tuple[str, ...]


def assess_folds(
    lenses: Mapping[str, Intrinsics], observed_px: Mapping[str, Float[np.ndarray, "_ 2"]]
) -> FoldFindings:
    """Decide which fitted lenses may be used although they fold their image.

    A lens folds the image where its distortion maps two rays to one pixel. This happens when a
    distortion that was fitted to the middle of the image is extrapolated. The lens may be used if
    all observations are nearer to the middle of the image than the fold, and only a small part of
    the image is farther out.

    Parameters
    ----------
    lenses : fitted lenses, by the name of their camera.
    observed_px : observed pixels of each camera, (n, 2).
    """
    notes = []
    for camera, lens in lenses.items():
        fold = describe_fold(lens)
        if fold is None:
            continue
        usable = describe_usable_fold(lens)
        offset = observed_px[camera] - np.asarray(lens.principal_point_px)
        if usable is None or (np.linalg.norm(offset, axis=1) > lens.valid_radius_px).any():
            return FoldFindings(sentences.lens_folds(camera, fold), ())
        notes.append(sentences.lens_folds_outside(camera, usable))
    return FoldFindings(None, tuple(notes))


def observed_pixels(views: Sequence[BoardObservation], camera: int) -> Float[np.ndarray, "n 2"]:
    """Pixels of all used circles or corners of one camera, (n, 2).

    camera : index of the camera.
    """
    pixels = [view.detection.centres_px[view.used] for view in views if view.camera == camera]
    return np.concatenate([np.zeros((0, 2)), *pixels])


def fix_folding(fit: RobustFit, cameras: Sequence[str]) -> tuple[RobustFit, tuple[str, ...]]:
    """Fix distortion coefficients of lenses that fold their image, and fit again.

    A lens folds the image where its distortion maps two rays to one pixel. The coefficients in
    `dispensable` of the lens model are fixed at 0 one after the other, until no lens folds. Given
    lenses and lenses that do not fold are not changed. If this does not help, or if the residuals
    grow too much, the given fit is returned.

    cameras : names of the cameras.

    Returns
    -------
    The fit, and one note for each changed lens.
    """
    problem, folds = fit.problem, _folds(fit.problem)
    if not folds:
        return fit, ()
    changed, model = fit, problem.state.lenses
    for name in model.dispensable:
        column, free = model.parameter_names.index(name), free_of_lenses(changed.problem)
        rows = [lens for lens in _folds(changed.problem) if free[lens, column]]
        if not rows:
            continue
        free[rows, column] = False
        changed = refit(with_lens_free(changed.problem, free), changed.rejected_images)
        if not _folds(changed.problem):
            all_cameras = range(len(cameras))
            rise = _rms_px(changed.problem, all_cameras) / _rms_px(problem, all_cameras)
            if not rise <= problem.tuning.answer.most_rise_by_fixing:
                return fit, ()
            return changed, _fixed_sentences(fit, changed, folds, cameras)
    return fit, ()


def fit_wider_model(
    folding: "ShotsFit",
    fit_model: "Callable[[type[AbstractLens]], ShotsFit]",
    cameras: Sequence[str],
) -> "ShotsFit":
    """Fit another lens model if a lens of the given fit folds its image.

    A lens folds the image where its distortion maps two rays to one pixel. With the Brown-Conrady
    polynomial this happens for wide lenses that were observed only in the middle of the image.

    Parameters
    ----------
    folding : the given fit.
    fit_model : function that fits a lens model to the same observations.
    cameras : names of the cameras.

    Returns
    -------
    The fit of the first more general model that is determined, does not fold the image, and has
    residuals about as small, with a note on the change. The given fit if no model fulfils this, or
    if no lens folds.
    """
    folds = _folds(folding.fit.problem)
    if not folds:
        return folding
    all_cameras = range(len(cameras))
    folding_rms_px = _rms_px(folding.fit.problem, all_cameras)
    for model in _WIDER_MODELS:
        try:
            other = fit_model(model)
        except CalibrationError:
            continue
        if assess_fit(other.fit).status is not Status.CONVERGED:
            continue
        rms_px = _rms_px(other.fit.problem, all_cameras)
        fits_as_well = (
            rms_px <= folding.fit.problem.tuning.answer.most_rise_by_fixing * folding_rms_px
        )
        if not fits_as_well or _folds(other.fit.problem):
            continue
        lens_of_camera: list[int] = np.asarray(
            folding.fit.problem.parametrization.lens_of_camera
        ).tolist()
        lens, fold = next(iter(folds.items()))
        sentence = sentences.lens_model_widened(
            folding.fit.problem.state.lenses.model,
            cameras[lens_of_camera.index(lens)],
            fold,
            model.model,
            rms_px,
            folding_rms_px,
        )
        return dataclasses.replace(other, remarks=(sentence, *other.remarks))
    return folding


def _folds(problem: Problem) -> dict[int, str]:
    """Description of the fold of each fitted lens that folds its image, by the index of the lens.

    A lens folds the image where its distortion maps two rays to one pixel.
    """
    sizes, free = problem.image_sizes_px, free_of_lenses(problem)
    folds = {}
    for camera, lens in enumerate(np.asarray(problem.parametrization.lens_of_camera).tolist()):
        if lens in folds or not free[lens].any() or camera not in sizes:
            continue
        intrinsics = Intrinsics.of_lens(simplify_lens(lens_of_index(problem, lens)), sizes[camera])
        fold = describe_fold(intrinsics)
        if fold is not None:
            folds[lens] = fold
    return folds


def _fixed_sentences(
    before: RobustFit, after: RobustFit, folds: Mapping[int, str], cameras: Sequence[str]
) -> tuple[str, ...]:
    """Return one note for each lens with coefficients that were fixed because it folded the image.

    A note names the coefficients, the radius of the fold, and the residuals.

    before, after : fit with and without these coefficients.
    folds : description of the fold of each of these lenses, by index of the lens.
    """
    names = before.problem.state.lenses.parameter_names
    lens_of_camera = np.asarray(before.problem.parametrization.lens_of_camera).tolist()
    was_free, is_free = free_of_lenses(before.problem), free_of_lenses(after.problem)
    remarks = []
    for lens, fold in folds.items():
        members = [k for k, lens_index in enumerate(lens_of_camera) if lens_index == lens]
        fixed = [name for name, is_fixed in zip(names, was_free[lens] & ~is_free[lens]) if is_fixed]
        remarks.append(
            sentences.folding_coefficients_fixed(
                cameras[members[0]],
                fixed,
                fold,
                _rms_px(after.problem, members),
                _rms_px(before.problem, members),
            )
        )
    return tuple(remarks)


def _rms_px(problem: Problem, cameras: Sequence[int]) -> float:
    """Root mean square length of the used residuals of some cameras, px.

    If the board moved during a shot, residuals are computed with the best board pose of each image,
    so that the motion does not hide the residuals of the lens.
    """
    is_moved = any(view.has_motion_errors for view in problem.views)
    residuals = (
        errors_about_image_poses_px(problem, fit_image_poses(problem))
        if is_moved
        else errors_px(problem)
    )
    used_px = [
        errors[view.rows_used]
        for view, errors in zip(problem.views, residuals, strict=True)
        if view.camera in cameras
    ]
    residuals_px = np.concatenate([np.zeros((0, 2)), *used_px])
    return (
        float(np.sqrt(np.mean(np.sum(residuals_px**2, axis=1))))
        if len(residuals_px)
        else float("nan")
    )
