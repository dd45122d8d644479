"""Calibration from one image of the sheet per camera: all steps from detections to the result.

1. Each camera alone: an initial pose from its circles, or the reason why there is none.
2. All cameras together by circle centres, with sheet, lenses and aims as unknowns (`adjust`).
3. The grey levels of each image, fitted alone, give more precise positions of the circles. If they
   show that ink has spread, the cameras are adjusted again with the new size of the circles.
4. All cameras together by these positions, starting from the estimate of step 2.
5. Each camera uses its grey levels or its circles (`choose_observations`). If a camera does not use
   its grey levels, all cameras are adjusted once more. There are usually two adjustments, at most
   four.
6. Tests, notes and covariance (`assembly`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.adjustment.agreement import choose_observations
from trinoc.calib.adjustment.single_camera import fit_single_camera, observe_single_camera
from trinoc.calib.assembly import failed_fit, result_of_adjustments
from trinoc.calib.camera_notes import failure_of_camera
from trinoc.calib.detection.detection import Detection
from trinoc.calib.detection.orientation import Orientation, resolve_orientation
from trinoc.calib.detection.registry import detect_pattern
from trinoc.calib.photometric.encoding import AS_DELIVERED, Encoding, Response, neutral_mosaic
from trinoc.calib.photometric.scene import ImageShift
from trinoc.calib.photometric.views import refine_views
from trinoc.calib.problem.apparent_shift import apparent_shift
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors
from trinoc.calib.result.calibration import CalibrationResult, CameraFit, Status
from trinoc.calib.sentences import cameras_failed
from trinoc.calib.sheet_inputs import check_image_sizes, check_images, lens_of_each
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, DetectionError, InputError
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel, pose_model_over_sheet
from trinoc.geometry.rig import check_camera_names
from trinoc.image.grey import grey_image
from trinoc.numerics.precision import ArrayLike, in_float64


@in_float64
def calibrate(
    images: Mapping[str, ArrayLike],
    pattern: Pattern,
    lens: Intrinsics | Mapping[str, Intrinsics],
    *,
    pose_model: PoseModel | str = PoseModel.AIMED,
    method: Literal["pixels", "points"] = "pixels",
    throw: bool = True,
    systematics: Systematics | None = None,
    orientation: Orientation = None,
    bayer: str | None = None,
    response: Response = "fit",
    tuning: CalibTuning = TUNING,
) -> CalibrationResult:
    """Calibrate the cameras of a rig from one image of the sheet per camera.

    Parameters
    ----------
    images : grey or colour image of each camera, by name.
    pattern : the printed sheet.
    lens : intrinsics of all cameras, or a mapping with those of each camera by name.
    pose_model : estimated parameters of each pose. "aimed" (default): pan, tilt, swing and
        distance; the optical axis meets the origin of the sheet. "aim-free": also the point where
        the axis meets the sheet. A PoseModel is accepted, too.
    method : "pixels" (default) fits circle centres first, and then the grey levels near every edge
        of the sheet, which reaches the Cramer-Rao bound. If circles and grey levels of a camera
        contradict each other, its circles may be used. "points" fits the circle centres only.
        `fits[name].method` reports which was used.
    throw : whether a failed camera raises an error. If False, the rig contains the other cameras,
        and `failures` has the reason.
    systematics : standard deviations of the errors of sheet, lens and aim. Default: typical values
        for printers, paper, aiming by hand and data sheets (`Systematics.typical`). `Systematics()`
        assumes that all are exact.
    orientation : needed for a sheet that looks the same after a rotation, such as a plain grid of
        discs. "upright": X points to the right in every image, as nearly as possible. Or an earlier
        rig whose cameras have hardly moved since. Without it, the calibration of such a sheet
        fails.
    bayer : colours of the first two pixels of the first two rows of a raw colour mosaic, such as
        "RGGB". Each pixel is then fitted without interpolation.
    response : response of the cameras, "linear" or "srgb". With "fit" (default) an image is assumed
        linear, unless the profiles of its edges contradict this; then the response is fitted.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    The rig with its covariance, and the status, fit and notes of each camera.

    Raises
    ------
    InputError : a lens is missing, an image and its lens differ in size, one image is given for two
        cameras, or the pose model or method is unknown.
    CalibrationError : a camera failed. The error contains the reason for each failed camera and the
        result of the others. Without `throw`, it is raised only if all cameras failed.
    """
    if method not in ("pixels", "points"):
        raise InputError(f'method is {method!r}, but must be "pixels" or "points".')
    check_images(images, pattern)
    model = pose_model_over_sheet(pose_model)
    lenses = lens_of_each(lens, images)
    check_image_sizes(images, lenses)
    encoding = Encoding(bayer, response)
    encoding.check()
    priors = SheetPriors(model, systematics or Systematics.typical(lenses, tuning=tuning), tuning)
    detections, failures = {}, {}
    for name, image in images.items():
        try:
            grey = np.asarray(image) if bayer is None else neutral_mosaic(np.asarray(image))
            detections[name] = detect_pattern(grey, pattern, tuning=tuning)
        except DetectionError as error:
            failures[name] = str(error)
        except InputError as error:
            raise InputError(f'Camera "{name}": {error}') from error
    grey_levels = {}
    if method == "pixels":
        grey_levels = {name: grey_image(np.asarray(images[name])).grey for name in detections}
    return calibrate_sheet(
        detections, pattern, lenses, priors, orientation,
        images=grey_levels, encoding=encoding, failures=failures, throw=throw,
    )  # fmt: skip


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
    tuning: CalibTuning = TUNING,
) -> CalibrationResult:
    """Calibrate cameras from circles that are already detected.

    Parameters
    ----------
    detections : circles and lines of each camera's image, by the name of the camera.
    pattern, lens, pose_model, throw, systematics, orientation, tuning : see `trinoc.calibrate`.

    Returns
    -------
    The rig with its covariance, and the status, fit and notes of each camera. No grey levels are
    used.

    Raises
    ------
    InputError, CalibrationError : as in `trinoc.calibrate`.
    """
    check_camera_names(detections)
    lenses = lens_of_each(lens, detections)
    model = pose_model_over_sheet(pose_model)
    priors = SheetPriors(model, systematics or Systematics.typical(lenses, tuning=tuning), tuning)
    return calibrate_sheet(detections, pattern, lenses, priors, orientation, throw=throw)


def calibrate_sheet(
    detections: Mapping[str, Detection],
    pattern: Pattern,
    lenses: Mapping[str, Intrinsics],
    priors: SheetPriors,
    orientation: Orientation,
    *,
    images: Mapping[str, Float[np.ndarray, "_h _w"]] | None = None,
    encoding: Encoding = AS_DELIVERED,
    failures: Mapping[str, str] | None = None,
    throw: bool = True,
) -> CalibrationResult:
    """Calibrate cameras from detections of the sheet and, optionally, grey levels.

    Parameters
    ----------
    detections : circles and lines of each camera in whose image the sheet was detected.
    pattern : the sheet.
    lenses : intrinsics of all cameras, in the user's order.
    priors : priors of sheet, lenses and aims.
    orientation : see `trinoc.calibrate`.
    images : grey levels, (h, w), of the cameras that may use them.
    encoding : relation between grey levels and light.
    failures : reason for each camera in whose image the sheet was not detected.
    throw : whether a failed camera raises an error.

    Raises
    ------
    CalibrationError : as in `trinoc.calibrate`.
    """
    lens_factors = priors.systematics.lens_factors(lenses)
    detections, ambiguous = resolve_orientation(
        detections, pattern, orientation, tuning=priors.tuning
    )
    failures = {**(failures or {}), **ambiguous}
    status = dict.fromkeys(lenses, Status.NOT_DETECTED) | dict.fromkeys(ambiguous, Status.AMBIGUOUS)
    cameras: list[SheetCamera] = []
    failed_fits: dict[str, CameraFit] = {}
    for name in (name for name in lenses if name in detections and name not in ambiguous):
        detection, lens, factor = detections[name], lenses[name], lens_factors.get(name)
        image = (images or {}).get(name)
        # Circles that do not determine an aim with a prior still determine the rest of the pose.
        for model in dict.fromkeys((priors.fitted_model, priors.pose_model)):
            fit = fit_single_camera(detection, pattern, lens, model, image, priors.tuning)
            status[name], observability = observe_single_camera(fit)
            if status[name] is Status.CONVERGED:
                break
        failure = failure_of_camera(
            fit,
            status[name],
            observability,
            detection,
            lens,
            factor,
            priors.fitted_model,
            priors.tuning.answer,
        )
        if failure or fit is None:
            failures[name] = failure
            failed_fits[name] = failed_fit(detection, fit, status[name], observability)
        else:
            cameras.append(SheetCamera(name, detection, lens, factor, fit.pose(0), image))
    result = None
    if cameras:
        # Cameras of different groups share neither an uncertain sheet nor an uncertain lens.
        fits = [
            adjust_group(group, pattern, priors, encoding)
            for group in priors.systematics.groups(cameras)
        ]
        result = result_of_adjustments(fits, pattern, priors, status, failures, failed_fits)
    if result is not None and not (failures and throw):
        return result
    in_order = {name: failures[name] for name in lenses if name in failures}
    raise CalibrationError(cameras_failed(in_order, len(lenses)), failures, result)


def adjust_group(
    cameras: Sequence[SheetCamera], pattern: Pattern, priors: SheetPriors, encoding: Encoding
) -> tuple[Adjustment, Adjustment]:
    """Fit all cameras that share an uncertain sheet or lens together.

    Returns two adjustments: one with the circle centres of all cameras, and the final one, in which
    each camera uses its grey levels or its circle centres.

    priors : priors of sheet, lenses and aims.
    encoding : relation between grey levels and light.
    """
    by_circles = adjust(cameras, pattern, priors)
    cameras = fit_grey_levels(by_circles, pattern, encoding)
    if any(camera.ink_spread_mm for camera in cameras):
        # For a larger circle, the centre of its image is farther from the image of its centre.
        by_circles = adjust(cameras, pattern, priors, by_circles)
    candidates = [camera.by_pixels() for camera in cameras]
    adjustment = by_circles
    if any(camera.method == "pixels" for camera in candidates):
        adjustment = adjust(candidates, pattern, priors, by_circles)
    final_cameras = tuple(
        choose_observations(view, camera, by_circles, adjustment)
        for view, camera in enumerate(candidates)
    )
    if any(
        before.method != after.method or after.sigma_factor > 1.0
        for before, after in zip(candidates, final_cameras)
    ):
        adjustment = adjust(final_cameras, pattern, priors, by_circles)
    return by_circles, replace(adjustment, cameras=final_cameras)


def fit_grey_levels(
    by_circles: Adjustment, pattern: Pattern, encoding: Encoding
) -> list[SheetCamera]:
    """Fit the grey levels of each camera's image, with sheet and lens as estimated from the
    circles.

    Returns the cameras with `grey_level_fit`. They also have `ink_spread_mm`, if the ink extends so
    far beyond the drawn edges that it matters.

    by_circles : adjustment that uses the circle centres of all cameras.
    encoding : relation between grey levels and light.
    """
    images, poses, lenses = {}, {}, {}
    tuning = by_circles.problem.tuning
    shifts: dict[str, ImageShift] = {}
    for view, camera in zip(by_circles.problem.views, by_circles.cameras, strict=True):
        if camera.image is None:
            continue
        name, lens = camera.name, camera.lens.lens
        images[name], poses[name], lenses[name] = camera.image, camera.pose, lens
        shift = apparent_shift(by_circles.problem, view, camera.pose, lens)
        centres_mm = pattern.centres_mm[camera.detection.circle_index]
        if np.abs(shift(centres_mm)).max() > tuning.answer.least_shift_px:
            shifts[name] = shift
    model = by_circles.priors.fitted_model
    image_fits = refine_views(
        images, poses, pattern, lenses, model, shifts, encoding, tuning.photometric
    )
    cameras = [
        replace(camera, grey_level_fit=image_fits.get(camera.name)) for camera in by_circles.cameras
    ]
    qualities = [camera.grey_level_fit and camera.grey_level_fit.quality for camera in cameras]
    spreads_mm = [quality.ink_spread_mm if quality else 0.0 for quality in qualities]
    if max(map(abs, spreads_mm)) <= tuning.answer.least_spread_mm:
        return cameras
    return [replace(camera, ink_spread_mm=spread) for camera, spread in zip(cameras, spreads_mm)]
