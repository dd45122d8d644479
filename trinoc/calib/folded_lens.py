"""Fitted lenses that fold the image: a distortion that is not determined out to the corners."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.coefficients import free_of_lenses
from trinoc.calib.problem.moments import errors_about_image_poses_px, fit_image_poses
from trinoc.calib.problem.outcome import assess_fit
from trinoc.calib.problem.problem import Problem, lens_number, with_lens_free
from trinoc.calib.problem.robust_fit import RobustFit, errors_px, refit
from trinoc.calib.problem.status import Status
from trinoc.calib.problem.views import View
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
    """Folds of fitted lenses.

    Fields
    ------
    failure : sentence on the first lens that must not be used, with the remedy; None without one.
    notes : a sentence on each lens that folds where nothing was observed.
    """

    failure: str | None
    notes: tuple[str, ...]


def assess_folds(
    lenses: Mapping[str, Intrinsics], observed_px: Mapping[str, Float[np.ndarray, "_ 2"]]
) -> FoldFindings:
    """Decide which fitted lenses that fold their image may be used.

    A distortion that fits the corners observed in the middle of the image may fold it farther out.
    Such a lens is usable up to the fold, if everything observed lies before it and little of the
    image beyond.

    Parameters
    ----------
    lenses : by the name of their camera.
    observed_px : of each camera, the pixels that were fitted.
    """
    notes = []
    for camera, lens in lenses.items():
        fold = describe_fold(lens)
        if fold is None:
            continue
        usable = describe_usable_fold(lens)
        offset = observed_px[camera] - np.asarray(lens.principal_point_px)
        if usable is None or (np.linalg.norm(offset, axis=1) > lens.valid_radius_px).any():
            failure = (
                f'The fitted distortion of "{camera}" {fold}: show the board nearer to the corners '
                "of the image, fit fewer coefficients (distortion=1 or distortion=2), or name "
                "another lens model (rational, kannala_brandt)."
            )
            return FoldFindings(failure, ())
        notes.append(
            f'The distortion of "{camera}" {usable}. Show the board nearer to the corners of the '
            "image to use them."
        )
    return FoldFindings(None, tuple(notes))


def observed_pixels(views: Sequence[View], camera: int) -> Float[np.ndarray, "n 2"]:
    """Circles and corners of one camera that take part in a fit."""
    pixels = [view.detection.centres_px[view.used] for view in views if view.camera == camera]
    return np.concatenate([np.zeros((0, 2)), *pixels])


def hold_folding(fit: RobustFit, cameras: Sequence[str]) -> tuple[RobustFit, tuple[str, ...]]:
    """Fit again with fewer coefficients of each lens that folds its image, with a sentence on each.

    The dispensable coefficients of the lens model are fixed at 0 one after the other, until no lens
    folds. Only lenses that fold are changed. If that does not help, or if the residuals ask for
    these coefficients, the fit stays as it is.
    Lenses that are given are not changed.

    cameras : names, in the order of the problem.
    """
    problem, first = fit.problem, _folds(fit.problem)
    if not first:
        return fit, ()
    changed, model = fit, problem.state.lenses
    for name in model.dispensable:
        column, free = model.parameter_names.index(name), free_of_lenses(changed.problem)
        rows = [lens for lens in _folds(changed.problem) if free[lens, column]]
        if not rows:
            continue
        free[rows, column] = False
        changed = refit(with_lens_free(changed.problem, free), changed.elsewhere)
        if not _folds(changed.problem):
            every = range(len(cameras))
            rise = _rms_px(changed.problem, every) / _rms_px(problem, every)
            if not rise <= problem.tuning.answer.most_rise_by_fixing:
                return fit, ()
            return changed, _fixed_sentences(fit, changed, first, cameras)
    return fit, ()


def fit_wider_model(
    folding: "ShotsFit",
    fit_model: "Callable[[type[AbstractLens]], ShotsFit]",
    cameras: Sequence[str],
) -> "ShotsFit":
    """Return a fit by another lens model if a lens of this one folds its image.

    Cameras of wide lenses need it: the polynomial of Brown-Conrady, fitted where corners were
    observed, turns back between there and the corners of the image.

    Parameters
    ----------
    folding : the fit that may fold.
    fit_model : fits a lens model to the same observations.
    cameras : names, in the order of the problem.

    Returns
    -------
    The fit of the first wider model that is determined, folds no image and explains the
    observations, with a remark that reports the change; the fit that was given, if there is none
    or none is needed.
    """
    folds = _folds(folding.fit.problem)
    if not folds:
        return folding
    every = range(len(cameras))
    folding_rms_px = _rms_px(folding.fit.problem, every)
    for model in _WIDER_MODELS:
        try:
            other = fit_model(model)
        except CalibrationError:
            continue
        if assess_fit(other.fit).status is not Status.CONVERGED:
            continue
        rms_px = _rms_px(other.fit.problem, every)
        explains = rms_px <= folding.fit.problem.tuning.answer.most_rise_by_fixing * folding_rms_px
        if not explains or _folds(other.fit.problem):
            continue
        lens_of_camera = np.asarray(folding.fit.problem.parametrization.lens_of_camera).tolist()
        lens, fold = next(iter(folds.items()))
        sentence = (
            f"The {folding.fit.problem.state.lenses.model} distortion of "
            f'"{cameras[lens_of_camera.index(lens)]}" {fold}, so the lens model is {model.model}: '
            f"the rms residual is {rms_px:.3f} px instead of {folding_rms_px:.3f} px."
        )
        return dataclasses.replace(other, remarks=(sentence, *other.remarks))
    return folding


def _folds(problem: Problem) -> dict[int, str]:
    """What each fitted lens that folds its image does, by the number of the lens."""
    sizes, free = problem.image_sizes_px, free_of_lenses(problem)
    found = {}
    for camera, lens in enumerate(np.asarray(problem.parametrization.lens_of_camera).tolist()):
        if lens in found or not free[lens].any() or camera not in sizes:
            continue
        intrinsics = Intrinsics.of_lens(simplify_lens(lens_number(problem, lens)), sizes[camera])
        fold = describe_fold(intrinsics)
        if fold is not None:
            found[lens] = fold
    return found


def _fixed_sentences(
    before: RobustFit, after: RobustFit, folds: Mapping[int, str], cameras: Sequence[str]
) -> tuple[str, ...]:
    """Which coefficients were fixed and why, and what that costs, for each lens."""
    names = before.problem.state.lenses.parameter_names
    lens_of_camera = np.asarray(before.problem.parametrization.lens_of_camera).tolist()
    was, is_free = free_of_lenses(before.problem), free_of_lenses(after.problem)
    sentences = []
    for lens, fold in folds.items():
        own = [k for k, each in enumerate(lens_of_camera) if each == lens]
        fixed = [name for name, gone in zip(names, was[lens] & ~is_free[lens]) if gone]
        which, are = ", ".join(fixed), "is" if len(fixed) == 1 else "are"
        sentences.append(
            f'The distortion of "{cameras[own[0]]}" fitted with {which} {fold}, so {which} {are} '
            f"fixed at 0; the rms residual is {_rms_px(after.problem, own):.3f} px instead of "
            f"{_rms_px(before.problem, own):.3f} px. Show the board nearer to the corners of the "
            "image."
        )
    return tuple(sentences)


def _rms_px(problem: Problem, cameras: Sequence[int]) -> float:
    """Root mean square length of the residuals of some cameras.

    Where the board moves between the images of a shot, about the pose of each image: the motion
    would hide what a lens explains.
    """
    is_moved = any(view.is_moved for view in problem.views)
    residuals = (
        errors_about_image_poses_px(problem, fit_image_poses(problem))
        if is_moved
        else errors_px(problem)
    )
    kept = [
        errors[view.kept]
        for view, errors in zip(problem.views, residuals, strict=True)
        if view.camera in cameras
    ]
    every = np.concatenate([np.zeros((0, 2)), *kept])
    return float(np.sqrt(np.mean(np.sum(every**2, axis=1)))) if len(every) else float("nan")
