"""One camera's lens from the grey levels: a rig of one, from where its circles found it."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib.intrinsics import (
    IntrinsicsResult,
    LensModel,
    field_places_px,
    field_sigma_px,
    next_image,
)
from trinoc.calib.shots.covariance import information_of
from trinoc.calib.shots.foreseen import place_sigma_px
from trinoc.calib.shots.motions import chained
from trinoc.calib.shots.pixel_fit import fit_pixels
from trinoc.calib.shots.problem import Freedom, Problem, lens_number, problem_of
from trinoc.calib.shots.robust_fit import RobustFit, errors_px
from trinoc.calib.shots.shot_scatter import shot_scatter
from trinoc.calib.shots.table import View
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import Intrinsics, lens_model, promoted, simplified
from trinoc.numerics import ArrayLike, grey_image


def lens_of_pixels(
    found: IntrinsicsResult, images: Sequence[ArrayLike], model: str
) -> IntrinsicsResult:
    """The lens that circles have found, fitted to the grey levels of the pictures it came from.

    images : all that were given, of which `found.image_index` took part. model : of the lens.

    The same parameters are free, and the sheet is taken to be as drawn. Residuals stay those of
    the circles, by the lens and poses that the grey levels give.
    """
    assert found.lens is not None
    problem = _problem(found, found.lens, model)

    def grey_of(view: View) -> Float[np.ndarray, "h w"]:
        return grey_image(np.asarray(images[found.image_index[view.shot]])).grey

    fit, silent = fit_pixels(RobustFit(problem, True, [], float("nan"), 0), grey_of)
    ended, information = fit.problem, information_of(fit.problem)
    factor = shot_scatter(information).variance_factor
    lens, size_px = lens_number(ended, 0), found.lens.image_size_px
    rows = np.arange(len(lens.parameter_names))
    scale = np.asarray(ended.chart.lens_scale)[0]
    covariance = np.zeros((len(rows), len(rows)))
    free = information.free
    covariance[np.ix_(free, free)] = factor * information.seen.covariance
    covariance *= np.outer(scale, scale)
    circles = ended._replace(views=tuple(view._replace(shown=None) for view in ended.views))
    coefficients = tuple(name for name in lens.coefficient_names if name in found.free)
    own = LensModel(type(lens), coefficients, "cx_px" in found.free)
    advice = next_image(
        lens,
        scale,
        information.of_shot.sum(axis=0)[np.ix_(rows, rows)] / factor,
        np.isfinite(np.diag(covariance)),
        own,
        found.pattern,
        size_px,
        float(np.sqrt(factor) * place_sigma_px(ended)[0]),
    )
    notes = [
        f"Picture {found.image_index[shot] + 1} counts by its circles: {why}"
        for _, shot, why in silent
    ]
    cam = np.asarray(ended.state.cam_from_rig)[0]
    return dataclasses.replace(
        found,
        lens=Intrinsics.of_lens(simplified(lens), size_px, found.lens.pixel_pitch_mm),
        parameters=lens.parameter_names,
        values=np.array(lens.parameters),
        covariance=covariance,
        reduced_chi_square=fit.chi_square / fit.freedom,
        field_sigma_px=np.asarray(field_sigma_px(lens, covariance, field_places_px(size_px))),
        cam_from_world=np.stack(
            [chained(cam, np.asarray(b)) for b in ended.state.rig_from_board[: ended.shots]]
        ),
        residuals_px=errors_px(circles),
        used=[view.used for view in ended.views],
        notes=(*found.notes, *notes),
        next_image=advice,
    )


def _problem(found: IntrinsicsResult, intrinsics: Intrinsics, model: str) -> Problem:
    """The rig of one camera, at the lens and the poses that the circles gave."""
    lens = promoted(intrinsics.lens, lens_model(model))
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
