"""Public result of a calibration over one sheet, built from the adjustments of all cameras."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy
from jaxtyping import Float

from trinoc.calib import sentences
from trinoc.calib.adjustment.adjustment import Adjustment
from trinoc.calib.adjustment.measurement_advice import (
    advise_measurement,
    find_undetectable_errors,
)
from trinoc.calib.adjustment.model_tests import run_fixed_parameter_tests
from trinoc.calib.adjustment.prior_pulls import PriorPull, refuted_priors
from trinoc.calib.camera_notes import (
    is_suspect,
    notes_of_aim,
    notes_of_camera,
    notes_of_misfit,
    notes_of_priors,
    notes_of_sheet,
)
from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.sheet_problem import SheetPriors
from trinoc.calib.result.calibration import CalibrationResult, CameraFit, Status
from trinoc.calib.result.degrees import values_of_parameters
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.registry import simplify_lens
from trinoc.geometry.rig import PARAMETER_NAMES, Rig
from trinoc.numerics.information import Observability
from trinoc.numerics.precision import in_float64


@in_float64
def result_of_adjustments(
    fits: Sequence[tuple[Adjustment, Adjustment]],
    pattern: Pattern,
    priors: SheetPriors,
    status: Mapping[str, Status],
    failures: dict[str, str],
    failed_fits: Mapping[str, CameraFit],
) -> CalibrationResult:
    """Assemble the public result of a calibration from images of one sheet: rig, covariance, tests
    and notes.

    Parameters
    ----------
    fits : for each independent group of cameras, two adjustments: with circle centres only, and the
        final one, with the chosen observations.
    pattern : the sheet.
    priors : priors of sheet, lenses and aims.
    status : status of each camera, in the user's order.
    failures : reason for each camera without a result.
    failed_fits : fits of the cameras that are not in the rig.
    """
    cameras: dict[str, Camera] = {}
    status_of_camera, camera_fits = dict(status), dict(failed_fits)
    covariance_names: list[str] = []
    covariance_blocks: list[np.ndarray] = []
    parameters: list[str] = []
    values: list[np.ndarray] = []
    sheet_notes: list[str] = []
    pose_parameters = priors.pose_model.parameter_names
    for by_circles, adjustment in fits:
        pulls = refuted_priors(adjustment)
        sheet_notes += notes_of_sheet(pulls, adjustment)
        views = range(len(adjustment.cameras))
        observabilities = [adjustment.observability(view) for view in views]
        names, block = _named_covariance(adjustment, observabilities)
        covariance_names += names
        covariance_blocks.append(block)
        for view, observability in zip(views, observabilities, strict=True):
            name = adjustment.cameras[view].name
            cameras[name] = _camera(adjustment, view)
            camera_fits[name], suspect = _camera_fit(
                by_circles, adjustment, view, observability, pulls
            )
            if suspect:
                status_of_camera[name] = Status.SUSPECT
            pose_values = values_of_parameters(adjustment.parameters(view))
            values.append(pose_values[: len(pose_parameters)])
            parameters += [f"{name}.{parameter}" for parameter in pose_parameters]
    covariance = np.asarray(scipy.linalg.block_diag(*covariance_blocks))
    measurement = advise_measurement([final for _, final in fits], priors.systematics)
    tests = [test for name in cameras for test in camera_fits[name].fixed_parameter_tests]
    advice = [sentences.undetectable_errors(*find_undetectable_errors(tests))]
    if measurement is not None:
        advice.insert(0, sentences.measurement_advice(measurement))
    rows = [covariance_names.index(parameter) for parameter in parameters]
    return CalibrationResult(
        solution=Rig(cameras, parameters=covariance_names, covariance=covariance),
        status=status_of_camera,
        parameters=tuple(parameters),
        values=np.concatenate(values),
        covariance=covariance[np.ix_(rows, rows)],
        fits=camera_fits,
        target=pattern,
        failures=failures,
        systematics=priors.systematics.descriptions,
        notes=tuple(dict.fromkeys(sheet_notes)),
        advice=" ".join(filter(None, advice)),
    )


def _named_covariance(
    adjustment: Adjustment, observabilities: Sequence[Observability]
) -> tuple[list[str], Float[np.ndarray, "k k"]]:
    """Names and covariance of the pose parameters of all cameras, in degrees and mm.

    If a lens is uncertain, its focal lengths and principal point are included. Undetermined
    parameters are NaN.
    """
    names: list[str] = []
    jacobians: list[np.ndarray] = []
    undetermined: list[int] = []
    for k, camera in enumerate(adjustment.cameras):
        steps = adjustment.rows(k)
        pose_jacobian = np.zeros((len(steps), len(adjustment.covariance)))
        pose_jacobian[:, steps] = adjustment.degrees_by_step(k)
        undetermined += [len(names) + row for row in observabilities[k].gauge]
        names += [f"{camera.name}.{key}" for key in PARAMETER_NAMES[: len(pose_jacobian)]]
        jacobians.append(pose_jacobian)
        if camera.lens_factor is not None:
            lens_jacobian = np.zeros((len(AFFINE_PARAMETERS), len(adjustment.covariance)))
            factor = camera.lens_factor[: len(AFFINE_PARAMETERS)]
            lens_jacobian[: len(factor), adjustment.lens_rows(k)] = factor
            names += [f"{camera.name}.{key}" for key in AFFINE_PARAMETERS]
            jacobians.append(lens_jacobian)
    jacobian = np.concatenate(jacobians)
    covariance = jacobian @ adjustment.covariance @ jacobian.T
    # Files hold no matrix that rounding made other than symmetric.
    covariance = 0.5 * (covariance + covariance.T)
    covariance[undetermined] = np.nan
    covariance[:, undetermined] = np.nan
    return names, covariance


def _camera(adjustment: Adjustment, view: int) -> Camera:
    camera, pose = adjustment.cameras[view], adjustment.pose(view)
    if camera.lens_factor is None:
        return Camera(camera.lens, pose)
    lens, stated = simplify_lens(adjustment.lens(view)), camera.lens
    return Camera(Intrinsics.of_lens(lens, stated.image_size_px, stated.pixel_pitch_mm), pose)


def _camera_fit(
    by_circles: Adjustment,
    adjustment: Adjustment,
    view: int,
    observability: Observability,
    pulls: Sequence[PriorPull],
) -> tuple[CameraFit, bool]:
    """Fit of one camera, and whether its status is SUSPECT.

    It is SUSPECT in three cases: the images contradict a prior of lens, aim or sheet; the residuals
    contradict a fixed parameter; or neighbouring circles have similar residuals far above the
    noise.

    Parameters
    ----------
    by_circles : adjustment that uses the circle centres of all cameras.
    adjustment : final adjustment of all cameras.
    view : index of the camera.
    observability : pose parameters that are determined.
    pulls : contradicted priors.
    """
    camera = adjustment.cameras[view]
    source = adjustment if camera.method == "pixels" else by_circles
    tests = run_fixed_parameter_tests(source, view)
    gauge = tuple(PARAMETER_NAMES[k] for k in observability.gauge)
    prior_notes, misfit_notes = notes_of_priors(pulls, adjustment, view), ()
    suspect = bool(prior_notes) or is_suspect(
        tests, float(source.reduced_chi_square[view]), source.problem.tuning.answer
    )
    if not suspect:
        misfit_notes = notes_of_misfit(by_circles, view)
        suspect = bool(misfit_notes)
    camera_notes = notes_of_camera(camera, by_circles, view, tests, gauge)
    aim_notes = ()
    if not any(pull.concerns_aim(view) for pull in pulls):
        aim_notes = notes_of_aim(adjustment, view)
    circles_at_solution = by_circles.problem._replace(state=adjustment.problem.state)
    camera_fit = CameraFit(
        detections=(camera.detection,),
        residuals_px=errors_px(circles_at_solution)[view],
        rank=observability.rank,
        reduced_chi_square=float(by_circles.reduced_chi_square[view]),
        gauge=gauge,
        notes=(*prior_notes, *misfit_notes, *aim_notes, *camera_notes),
        used=by_circles.used[view],
        image=camera.grey_level_fit.quality
        if camera.grey_level_fit and camera.grey_level_points is not None
        else None,
        fixed_parameter_tests=tuple(tests),
        method=camera.method,
    )
    return camera_fit, suspect


def failed_fit(
    detection: Detection, fit: Adjustment | None, status: Status, observability: Observability
) -> CameraFit:
    """`CameraFit` of a camera whose calibration failed. Values that could not be
    computed are NaN.
    """
    residuals_px, count = np.full((len(detection), 2), np.nan), len(detection)
    if fit is not None and status is not Status.NOT_CONVERGED:
        residuals_px = errors_px(fit.problem)[0]
    return CameraFit(
        detections=(detection,),
        residuals_px=residuals_px,
        rank=observability.rank,
        reduced_chi_square=float("nan") if fit is None else float(fit.reduced_chi_square[0]),
        gauge=tuple(PARAMETER_NAMES[k] for k in observability.gauge),
        notes=(),
        used=np.ones(count, dtype=bool) if fit is None else fit.used[0],
    )
