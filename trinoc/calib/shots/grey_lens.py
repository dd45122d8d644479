"""One camera's lens as a rig of one, from where its circles found it: corrected by splines, and
fitted to the grey levels."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.intrinsics import (
    IntrinsicsResult,
    LensImages,
    LensModel,
    NextImage,
    field_places_px,
    field_sigma_px,
    next_image,
    notes_of_lens,
)
from trinoc.calib.problem.information import information_of
from trinoc.calib.problem.motions import chained
from trinoc.calib.problem.problem import Freedom, Problem, lens_number
from trinoc.calib.problem.robust_fit import RobustFit, errors_px
from trinoc.calib.problem.shot_scatter import shot_scatter, with_factor
from trinoc.calib.problem.starting_problem import problem_of
from trinoc.calib.problem.views import View
from trinoc.calib.shots.foreseen import place_sigma_px
from trinoc.calib.shots.lens_correction import (
    correction_sentences,
    with_correction,
    with_settled_correction,
)
from trinoc.calib.shots.pixel_fit import fit_pixels
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import (
    AbstractLens,
    AbstractSplined,
    Intrinsics,
    lens_model,
    promoted,
    simplified,
)
from trinoc.image import grey_image
from trinoc.numerics import ArrayLike


def lens_of_rig(
    found: IntrinsicsResult, model: str, images: Sequence[ArrayLike] | None = None
) -> IntrinsicsResult:
    """The lens that circles have found, fitted as a rig of one camera.

    model : of the lens; of a splined one the circles have found the core.
    images : fit the grey levels of these, of which `found.image_index` took part; else the circles.

    The same parameters are free, and the sheet is taken to be as drawn. Residuals stay those of
    the circles, by the lens and poses that were found.
    """
    assert found.lens is not None
    size_px, silent = found.lens.image_size_px, []
    asked = lens_model(model)
    is_splined = issubclass(asked, AbstractSplined)
    core = asked.core_model if issubclass(asked, AbstractSplined) else asked
    fit = RobustFit(_problem(found, found.lens, core), True, [], float("nan"), 0)
    if is_splined:
        fit = with_correction(fit, [size_px])
    if images is not None:

        def grey_of(view: View) -> Float[np.ndarray, "h w"]:
            return grey_image(np.asarray(images[found.image_index[view.shot]])).grey

        fit, silent = fit_pixels(fit, grey_of)
        fit = with_settled_correction(fit)
    ended, information = fit.problem, information_of(fit.problem)
    factor = shot_scatter(information).variance_factor
    lens = lens_number(ended, 0)
    scale = np.asarray(ended.chart.lens_scale)[0]
    covariance = np.zeros((len(scale), len(scale)))
    free = information.free
    covariance[np.ix_(free, free)] = with_factor(
        information.seen.covariance, factor, information.prior
    )
    covariance *= np.outer(scale, scale)
    circles = ended._replace(views=tuple(view._replace(shown=None) for view in ended.views))
    used = [view.used for view in ended.views]
    notes = [*found.notes]
    if is_splined:
        seen = LensImages(list(found.detections), found.pattern, used)
        own = LensModel(type(lens), lens.coefficient_names)
        reduced = float(ended.sigma_factor[0]) ** 2
        notes = [*correction_sentences(ended, ("the camera",))]
        notes += notes_of_lens(lens, seen, own, reduced, found.image_index)
    notes += [
        f"Picture {found.image_index[shot] + 1} counts by its circles: {why}"
        for _, shot, why in silent
    ]
    cam = np.asarray(ended.state.cam_from_rig)[0]
    added = tuple(name for k, name in enumerate(lens.parameter_names) if k in free)
    return dataclasses.replace(
        found,
        lens=Intrinsics.of_lens(simplified(lens), size_px, found.lens.pixel_pitch_mm),
        parameters=lens.parameter_names,
        values=np.array(lens.parameters),
        covariance=covariance,
        free=added if is_splined else found.free,
        rank=len(added) if is_splined else found.rank,
        reduced_chi_square=fit.chi_square / fit.freedom,
        field_sigma_px=np.asarray(field_sigma_px(lens, covariance, field_places_px(size_px))),
        cam_from_world=np.stack(
            [chained(cam, np.asarray(b)) for b in ended.state.rig_from_board[: ended.shots]]
        ),
        residuals_px=errors_px(circles),
        used=used,
        notes=tuple(notes),
        next_image=_advice(
            found, lens, covariance, scale, float(np.sqrt(factor) * place_sigma_px(ended)[0])
        ),
    )


def _advice(
    found: IntrinsicsResult,
    lens: AbstractLens,
    covariance: Float[np.ndarray, "q q"],
    scale: Float[np.ndarray, "q"],
    sigma_px: float,
) -> NextImage | None:
    """The picture that would tell most of the lens, of its core where splines correct it."""
    if isinstance(lens, AbstractSplined):
        lens = lens.core
    names = lens.parameter_names
    coefficients = tuple(name for name in lens.coefficient_names if name in found.free)
    rows = np.array([k for k, name in enumerate(names) if name in found.free])
    scale = scale[: len(names)]
    information = np.zeros((len(names), len(names)))
    own = covariance[np.ix_(rows, rows)] / np.outer(scale[rows], scale[rows])
    information[np.ix_(rows, rows)] = np.linalg.inv(own)
    assert found.lens is not None
    return next_image(
        lens,
        scale,
        information,
        np.isfinite(np.diag(covariance))[: len(names)],
        LensModel(type(lens), coefficients, "cx_px" in found.free),
        found.pattern,
        found.lens.image_size_px,
        sigma_px,
    )


def _problem(found: IntrinsicsResult, intrinsics: Intrinsics, model: type[AbstractLens]) -> Problem:
    """The rig of one camera, at the lens and the poses that the circles gave."""
    lens = promoted(intrinsics.lens, model)
    views = [
        View(0, shot, detection, used)
        for shot, (detection, used) in enumerate(zip(found.detections, found.used, strict=True))
    ]
    free = np.array([[name in found.free for name in lens.parameter_names]])
    return problem_of(
        views,
        found.pattern,
        [lens],
        np.eye(3, 4)[None],
        found.cam_from_world,
        [intrinsics.image_size_px],
        Freedom(np.zeros(1, dtype=int), free),
        Systematics(),
    )
