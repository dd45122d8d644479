"""From fitted models of a lens to one judged result."""

import numpy as np
from jaxtyping import Float

from trinoc.calib.intrinsics.advice import NextImage
from trinoc.calib.intrinsics.field import field_places_px, field_sigma_px
from trinoc.calib.intrinsics.lens_information import lens_information
from trinoc.calib.intrinsics.lens_messages import (
    misfit_sentence,
    not_converged_sentence,
    notes_of_lens,
    undetermined_sentence,
)
from trinoc.calib.intrinsics.lens_parameters import LensModel
from trinoc.calib.intrinsics.model_choice import Candidate, choice_sentence, variance_factor
from trinoc.calib.intrinsics.next_picture import next_image
from trinoc.calib.intrinsics.result import IntrinsicsResult
from trinoc.calib.intrinsics.robust_lens import LensImages
from trinoc.calib.result import Status
from trinoc.errors import CalibrationError
from trinoc.geometry import AbstractLens, Intrinsics, simplified


def assess_lens(
    chosen: Candidate,
    asked: LensModel,
    images: LensImages,
    pixel_pitch_mm: tuple[float, float] | None,
    image_index: tuple[int, ...],
    failures: dict[int, str],
) -> IntrinsicsResult:
    """What a fit determines of the model that was asked for, and what to do next.

    Where the residuals are larger than the centres' own sigmas explain, the covariance is
    multiplied by the reduced chi-square: what disturbs the centres disturbs the lens. Raises
    CalibrationError where the circles do not lie where any lens would image them.
    """
    fit, model, seen = chosen.fit, chosen.model, chosen.seen
    misfit = misfit_sentence(fit, images)
    if misfit is not None:
        raise CalibrationError(misfit)
    reduced = chosen.reduced_chi_square
    status = _status(chosen)
    names = fit.lens.parameter_names
    gauge = tuple(names[k] for k in seen.gauge)
    notes = []
    if status is Status.RANK_DEFICIENT:
        notes.append(undetermined_sentence(gauge, fit, model))
    elif status is Status.NOT_CONVERGED:
        notes.append(not_converged_sentence(fit))
    choice = choice_sentence(chosen, asked)
    notes += [] if choice is None else [choice]
    notes += notes_of_lens(fit.lens, images, model, reduced, image_index)
    values = np.array(fit.lens.parameters)
    values[list(seen.gauge)] = np.nan
    good = status is Status.CONVERGED
    size = images.image_size_px
    return IntrinsicsResult(
        lens=Intrinsics.of_lens(simplified(fit.lens), size, pixel_pitch_mm) if good else None,
        status=status,
        parameters=names,
        values=values if status is not Status.NOT_CONVERGED else np.full_like(values, np.nan),
        covariance=seen.covariance,
        free=model.free,
        gauge=gauge,
        rank=seen.rank,
        reduced_chi_square=reduced,
        field_sigma_px=_field(fit.lens.with_parameters(values), seen.covariance, size),
        cam_from_world=np.asarray(fit.cam_from_world),
        detections=list(images.detections),
        residuals_px=[
            errors[: len(used)]
            for errors, used in zip(np.asarray(fit.residuals_px), images.used, strict=True)
        ],
        used=list(images.used),
        image_index=image_index,
        failures=failures,
        notes=tuple(notes),
        next_image=_advice(chosen, images),
        pattern=images.pattern,
    )


def _status(chosen: Candidate) -> Status:
    if chosen.seen.rank < len(chosen.model.free):
        return Status.RANK_DEFICIENT
    return Status.CONVERGED if chosen.fit.converged else Status.NOT_CONVERGED


def _field(
    lens: AbstractLens, covariance: Float[np.ndarray, "q q"], size: tuple[int, int]
) -> Float[np.ndarray, "5 5"]:
    return np.asarray(field_sigma_px(lens, covariance, field_places_px(size)))


def _advice(chosen: Candidate, images: LensImages) -> NextImage | None:
    factor = variance_factor(chosen.chi_square, chosen.freedom)
    areas = [np.linalg.det(each.covariance_px2) for each in images.detections]
    sigma_px = float(np.sqrt(factor) * np.median(np.concatenate(areas)) ** 0.25)
    fit = chosen.fit
    return next_image(
        fit.lens,
        np.asarray(fit.scale),
        lens_information(np.asarray(fit.information)).sum(axis=0) / factor,
        np.isfinite(np.diag(chosen.seen.covariance)),
        chosen.model,
        images.pattern,
        images.image_size_px,
        sigma_px,
    )
