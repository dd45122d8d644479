"""Calibrate a rig from circles that are already found."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection, Orientation, oriented
from trinoc.calib.messages import failure_sentence, is_suspect, notes_of_fit
from trinoc.calib.photometric import ViewEstimate, refine_views
from trinoc.calib.pose import fit_views, pose_of_values, score_test
from trinoc.calib.result import CalibrationResult, CameraFit, Status
from trinoc.calib.targets import Pattern
from trinoc.calib.uncertainty import Systematics, lens_spreads, with_spreads
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import Camera, Intrinsics, PoseModel, Rig, pose_model_over_sheet, promoted
from trinoc.numerics import in_float64


@in_float64
def calibrate_detections(
    detections: Mapping[str, Detection],
    pattern: Pattern,
    lens: Intrinsics | Mapping[str, Intrinsics],
    *,
    parameters: int | None = None,
    pose_model: PoseModel | str | None = None,
    throw: bool = True,
    systematics: Systematics | None = None,
    orientation: Orientation = None,
) -> CalibrationResult:
    """`trinoc.calibrate` from circles that are already found. Raises as it does."""
    lenses = lens_of_each(lens, detections)
    return calibration_of_detections(
        detections,
        {},
        pattern,
        lenses,
        pose_model_over_sheet(pose_model, parameters),
        throw,
        tuple(detections),
        systematics=systematics,
        orientation=orientation,
    )


def calibration_of_detections(
    detections: Mapping[str, Detection],
    failures: dict[str, str],
    pattern: Pattern,
    lenses: Mapping[str, Intrinsics],
    model: PoseModel,
    throw: bool,
    names: Sequence[str],
    images: Mapping[str, Float[np.ndarray, "_h _w"]] | None = None,
    systematics: Systematics | None = None,
    orientation: Orientation = None,
) -> CalibrationResult:
    """Fit the cameras whose sheet was found; `failures` are those of the others.

    With `images` the fit goes on from the circles to the grey levels.
    """
    factors = {} if systematics is None else systematics.lens_factors(lenses)
    detections, ambiguous = oriented(detections, pattern, orientation)
    failures = failures | ambiguous
    found = [name for name in detections if name not in ambiguous]
    fitted = fit_views(
        [detections[name] for name in found],
        pattern,
        [lenses[name] for name in found],
        model,
    )
    fits = dict(zip(found, fitted, strict=True))
    failures = failures | {
        name: sentence
        for name, fit in fits.items()
        if (sentence := failure_sentence(fit, detections[name], model)) is not None
    }
    refined = {name: ViewEstimate(fit, None, None) for name, fit in fits.items()}
    if images is not None:
        good = {name: fit for name, fit in fits.items() if name not in failures}
        refined |= refine_views(images, good, detections, pattern, lenses, model)
    result = assemble(refined, detections, failures, pattern, lenses, model, names)
    if result is not None:
        result = _with_suspects(result, lenses, factors, ambiguous)
        if systematics is not None:
            good = {name: refined[name] for name in result.rig.names}
            spreads = {}
            if images is not None and factors:
                spreads = lens_spreads(images, good, detections, pattern, lenses, factors)
            result = with_spreads(result, systematics, factors, spreads)
    if failures and (throw or result is None):
        told = "; ".join(f'camera "{name}": {failures[name]}' for name in names if name in failures)
        raise CalibrationError(
            f"{len(failures)} of {len(names)} cameras failed. {told[:1].upper()}{told[1:]}",
            failures,
            result,
        )
    assert result is not None
    return result


def _with_suspects(
    result: CalibrationResult,
    lenses: Mapping[str, Intrinsics],
    lens_factors: Mapping[str, Float[np.ndarray, "_ _"]],
    ambiguous: Mapping[str, str],
) -> CalibrationResult:
    """Statuses of cameras that may be labelled in several ways, or do not fit their lens."""
    status = result.status | dict.fromkeys(ambiguous, Status.AMBIGUOUS)
    for name in result.rig.names:
        sigmas = None
        if name in lens_factors:
            factor = lens_factors[name]
            parameters = promoted(lenses[name].lens).parameter_names[: len(factor)]
            sigmas = dict(zip(parameters, np.linalg.norm(factor, axis=1), strict=True))
        if is_suspect(result.fits[name], lenses[name], sigmas):
            status[name] = Status.SUSPECT
    return replace(result, status=status)


def assemble(
    refined: Mapping[str, ViewEstimate],
    detections: Mapping[str, Detection],
    failures: dict[str, str],
    pattern: Pattern,
    lenses: Mapping[str, Intrinsics],
    model: PoseModel,
    names: Sequence[str],
) -> CalibrationResult | None:
    """The result of the cameras that did not fail, or None where all did."""
    fits = {name: item.fit for name, item in refined.items()}
    good = [name for name in names if name in fits and name not in failures]
    if not good:
        return None
    kept = model.parameter_names
    parameters = tuple(f"{name}.{parameter}" for name in good for parameter in kept)
    covariance = np.zeros((len(parameters), len(parameters)))
    for k, name in enumerate(good):
        block = slice(k * model.size, (k + 1) * model.size)
        covariance[block, block] = fits[name].covariance
    return CalibrationResult(
        rig=Rig(
            {name: Camera(lenses[name], pose_of_values(fits[name].values)) for name in good},
            parameters=parameters,
            covariance=covariance,
        ),
        status={name: fits[name].status if name in fits else Status.NOT_DETECTED for name in names},
        parameters=parameters,
        values=np.concatenate([fits[name].values[: model.size] for name in good]),
        covariance=covariance,
        fits={
            name: _camera_fit(item, detections[name], pattern, lenses[name])
            for name, item in refined.items()
        },
        pattern=pattern,
        failures=failures,
    )


def _camera_fit(
    refined: ViewEstimate, detection: Detection, pattern: Pattern, lens: Intrinsics
) -> CameraFit:
    fit = refined.fit
    alternatives = ()
    if fit.status is Status.CONVERGED:
        alternatives = tuple(score_test(fit, lens, detection, pattern))
    return CameraFit(
        detection=detection,
        residuals_px=fit.residuals_px,
        rank=fit.rank,
        reduced_chi_square=fit.reduced_chi_square,
        gauge=fit.gauge,
        notes=notes_of_fit(refined, detection, pattern, alternatives),
        used=fit.used,
        image=refined.quality,
        alternatives=alternatives,
    )


def lens_of_each(
    lens: Intrinsics | Mapping[str, Intrinsics], names: Mapping[str, object]
) -> dict[str, Intrinsics]:
    """The intrinsics of every camera, from those of one or of each. Raises InputError."""
    if not names:
        raise InputError("No picture was given: give one for each camera, by name.")
    if isinstance(lens, Intrinsics):
        return dict.fromkeys(names, lens)
    missing = [name for name in names if name not in lens]
    if missing:
        raise InputError(
            f'There is no lens for camera "{missing[0]}": give one Intrinsics for all cameras, '
            "or one for each by name."
        )
    return {name: lens[name] for name in names}
