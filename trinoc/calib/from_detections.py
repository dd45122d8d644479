"""Calibrate a rig from circles that are already found."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.each_camera import PoseEstimate
from trinoc.calib.assembly import result_of_fits
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.orientation import Orientation, resolve_orientation
from trinoc.calib.messages import failure_sentence
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.result.calibration import CalibrationResult, CameraFit, Status
from trinoc.calib.result.degrees import pose_of_values
from trinoc.calib.rig_fit import Knowledge, fit_circles, fit_rig
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError, check_kind
from trinoc.geometry.intrinsics import A_LENS, Intrinsics
from trinoc.geometry.pose import PoseModel, pose_model_over_sheet
from trinoc.geometry.rig import check_camera_names
from trinoc.numerics.precision import in_float64


class Search(NamedTuple):
    """What looking for the sheet has found in the pictures of all cameras.

    Fields
    ------
    names : of all cameras, in the user's order.
    detections : of those in whose pictures it was found.
    images : (h, w) grey levels of the cameras whose grey levels are to be fitted.
    failures : for each of the others, a sentence that says why.
    """

    names: Sequence[str]
    detections: Mapping[str, Detection]
    images: Mapping[str, Float[np.ndarray, "_h _w"]]
    failures: Mapping[str, str]


@in_float64
def calibrate_detections(
    detections: Mapping[str, Detection],
    pattern: Pattern,
    lens: Intrinsics | Mapping[str, Intrinsics],
    *,
    pose_model: PoseModel | str = PoseModel.AIMED,
    throw: bool = True,
    systematics: Systematics | None = None,
    orientation: Orientation = None,
) -> CalibrationResult:
    """`trinoc.calibrate` from circles that are already found. Raises as it does."""
    check_camera_names(detections)
    lenses = lens_of_each(lens, detections)
    model = pose_model_over_sheet(pose_model)
    search = Search(tuple(detections), detections, {}, {})
    known = Knowledge(pattern, model, systematics or Systematics.typical(lenses))
    return calibration_of_search(search, lenses, known, orientation, throw=throw)


def calibration_of_search(
    search: Search,
    lenses: Mapping[str, Intrinsics],
    known: Knowledge,
    orientation: Orientation,
    *,
    throw: bool,
) -> CalibrationResult:
    """Fit the cameras whose sheet was found. Raises CalibrationError."""
    known.systematics.check()
    failures, result = _fit_detected_cameras(search, lenses, known, orientation)
    if result is not None and not (failures and throw):
        return result
    told = "; ".join(
        f'camera "{name}": {failures[name]}' for name in search.names if name in failures
    )
    raise CalibrationError(
        f"{len(failures)} of {len(search.names)} cameras failed. {told[:1].upper()}{told[1:]}",
        failures,
        result,
    )


def _fit_detected_cameras(
    search: Search,
    lenses: Mapping[str, Intrinsics],
    known: Knowledge,
    orientation: Orientation,
) -> tuple[dict[str, str], CalibrationResult | None]:
    """Sentences for the cameras that failed, and the result of the others, if any."""
    lens_factors = known.systematics.lens_factors(lenses)
    detections, ambiguous = resolve_orientation(search.detections, known.pattern, orientation)
    status = dict.fromkeys(search.names, Status.NOT_DETECTED)
    failures = {**search.failures, **ambiguous}
    cameras: list[SheetCamera] = []
    failed_fits: dict[str, CameraFit] = {}
    for name in search.names:
        if name not in detections or name in ambiguous:
            continue
        detection, lens, factor = detections[name], lenses[name], lens_factors.get(name)
        image = search.images.get(name)
        estimate = fit_circles(detection, lens, known, image)
        status[name] = estimate.status
        failure = failure_sentence(estimate, detection, known.fitted_model, lens, factor)
        if failure is None:
            pose = pose_of_values(estimate.values)
            cameras.append(SheetCamera(name, detection, lens, factor, pose, image))
        else:
            failures[name] = failure
            failed_fits[name] = _failed_fit(detection, estimate)
    status |= dict.fromkeys(ambiguous, Status.AMBIGUOUS)
    result = None
    if cameras:
        fits = [fit_rig(group, known) for group in known.systematics.groups(cameras)]
        result = result_of_fits(fits, known, status, failures, failed_fits)
    return failures, result


def _failed_fit(detection: Detection, estimate: PoseEstimate) -> CameraFit:
    """What is known of a camera whose circles give no pose."""
    return CameraFit(
        detections=(detection,),
        residuals_px=estimate.residuals_px,
        rank=estimate.rank,
        reduced_chi_square=estimate.reduced_chi_square,
        gauge=estimate.gauge,
        notes=(),
        used=estimate.used,
    )


def lens_of_each(
    lens: Intrinsics | Mapping[str, Intrinsics], names: Mapping[str, object]
) -> dict[str, Intrinsics]:
    """The intrinsics of every camera, from those of one or of each. Raises InputError."""
    if not names:
        raise InputError("No picture was given: give one for each camera, by name.")
    if isinstance(lens, Intrinsics):
        return dict.fromkeys(names, lens)
    check_kind(lens, Mapping, "lens", f"{A_LENS}, or a dictionary of each camera's")
    missing = [name for name in names if name not in lens]
    if missing:
        raise InputError(
            f'There is no lens for camera "{missing[0]}": give one Intrinsics for all cameras, '
            "or one for each by name."
        )
    return {name: lens[name] for name in names}
