"""Calibration of one camera from points with known coordinates, on a plane or not, and their
pixels.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from trinoc.calib import sentences
from trinoc.calib.lens_of_points import (
    CAMERA,
    extend_lens,
    fit_without_outliers,
    problem_of_points,
)
from trinoc.calib.problem.information import whiten_views
from trinoc.calib.problem.problem import Problem, lens_of_index
from trinoc.calib.problem.robust_fit import errors_px
from trinoc.calib.problem.status import Status
from trinoc.calib.refutations import refutations_of_points
from trinoc.calib.result.calibration import CalibrationResult, CameraFit
from trinoc.calib.result.degrees import degrees_by_step
from trinoc.calib.starts.resection import find_linear_camera, find_pose, is_flat
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS, AbstractLens
from trinoc.geometry.lenses.registry import promote_lens, simplify_lens
from trinoc.geometry.lenses.skewed import SKEW, SkewedThinPrism, skew_lens, straighten_lens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.rig import Rig
from trinoc.numerics.information import LARGEST_SIGMA
from trinoc.numerics.precision import ArrayLike, in_float64, real_array


@in_float64
def calibrate_points(
    points_mm: Float[ArrayLike, "n 3"],
    uv_px: Float[ArrayLike, "n 2"],
    lens: Intrinsics | None = None,
    *,
    image_size_px: tuple[int, int] | None = None,
    free: Sequence[str] | None = None,
    pose_model: PoseModel | str = PoseModel.RIGID,
    systematics: Systematics | None = None,
    tuning: CalibTuning = TUNING,
) -> CalibrationResult:
    """Calibrate one camera from points with known world coordinates and their pixels.

    The pose is always estimated; lens parameters are estimated if they are free.

    Parameters
    ----------
    points_mm : (n, 3) world coordinates of four or more points. If the lens is estimated, they must
        not lie in one plane.
    uv_px : (n, 2) pixels of the points in the original (distorted) image.
    lens : intrinsics. Without it, `image_size_px` is needed, and the lens is estimated: focal
        lengths, principal point, and as many Brown-Conrady coefficients, and a skew, as the
        residuals need. The initial values come from a direct linear transform (Hartley and
        Zisserman, 7.1).
    image_size_px : (width, height) of the image; needed without `lens`.
    free : names of the lens parameters to estimate: fx_px, fy_px, cx_px, cy_px, skew_px, and the
        coefficients of the lens's model or of a more general model. Their initial values are those
        of `lens`.
    pose_model : "rigid": any motion. "aim-free": also any motion, but its parameters are pan, tilt,
        swing, distance and aim. "aimed": the optical axis meets the origin of the world.
    systematics : its `lens_covariance` is the covariance of the lens parameters that are not
        estimated; the covariance of the result contains it. Default: that of a data sheet, if the
        lens comes from one (`Systematics.typical`). `Systematics()` assumes an exact lens. Points
        are always assumed exact.
    tuning : constants of calibration; a benchmark or a study changes them.

    Returns
    -------
    A rig of one camera. Its status is SUSPECT, with a warning, in two cases. First: the points
    contradict a lens parameter or aim that is assumed exact (Rao's score test with the noise of the
    residuals). Second: they contradict an uncertain lens by more than four sigmas.

    Raises
    ------
    InputError : wrong shapes, numbers or names.
    CalibrationError : the points do not determine the camera, they lie behind it (a left-handed
        frame), or the fit did not converge.
    """
    points = np.ascontiguousarray(real_array(points_mm, "points_mm"))
    pixels = np.ascontiguousarray(real_array(uv_px, "uv_px"))
    model = PoseModel.of(pose_model)
    names = tuple((() if lens is not None else AFFINE_PARAMETERS) if free is None else free)
    _check(points, pixels, lens, image_size_px, names, tuning)
    if lens is None:
        assert image_size_px is not None
        camera = find_linear_camera(points, pixels, image_size_px)
    else:
        camera = Camera(lens, find_pose(points, pixels, lens, tuning=tuning))
    problem = fit_without_outliers(problem_of_points(camera, points, pixels, names, model, tuning))
    if lens is None and free is None:
        problem, names = extend_lens(problem, names)
    lenses = {CAMERA: camera.intrinsics} if lens else {}
    priors = systematics or Systematics.typical(lenses, tuning=tuning)
    factor = priors.lens_factors({CAMERA: camera.intrinsics}).get(CAMERA, np.zeros((0, 0)))
    lens_errors = np.zeros((problem.parametrization.lens_shape[1], factor.shape[1]))
    lens_errors[: len(factor)] = factor
    lens_errors[[name in names for name in problem.state.lenses.parameter_names]] = 0.0
    return _result(problem, names, model, camera.intrinsics, lens_errors)


def _result(
    problem: Problem,
    names: tuple[str, ...],
    model: PoseModel,
    lens: Intrinsics,
    lens_errors: Float[np.ndarray, "q r"],
) -> CalibrationResult:
    """Compute covariance and tests of a fit, and build the public result.

    names : names of the estimated lens parameters.
    lens_errors : (q, r) change of the q lens parameters for one sigma of each of r errors of the
        given lens.
    """
    (view,), parametrization = problem.views, problem.parametrization
    used = view.used
    full_jacobian = whiten_views(problem).jacobian[0][: 2 * len(used)][np.repeat(used, 2)]
    scale, pose_rows = np.asarray(parametrization.lens_scale)[0], parametrization.slices.camera(0)
    rows = [problem.state.lenses.parameter_names.index(name) for name in names]
    columns = [*range(pose_rows.start, pose_rows.start + model.size), *rows]
    parameters = (*model.parameter_names, *names)
    jacobian = full_jacobian[:, columns]
    residuals_px = errors_px(problem)[0]
    freedom = len(jacobian) - len(columns)
    if freedom < 0:
        raise CalibrationError(
            f"{int(used.sum())} points do not determine {len(columns)} parameters: give more."
        )
    chi = float(np.sum(residuals_px[used] ** 2))
    noise = float(np.sqrt(chi / freedom)) if freedom else float("nan")
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    sigma = (noise if freedom else 1.0) / np.sqrt(np.maximum(values, 1e-300))
    is_undetermined = (sigma > LARGEST_SIGMA) | (values < 1e-14 * values[-1])
    if is_undetermined.any():
        is_affected = (vectors[:, is_undetermined] ** 2).sum(axis=1) > 0.02
        undetermined = ", ".join(
            name for name, affected in zip(parameters, is_affected, strict=True) if affected
        )
        raise CalibrationError(
            f"{int(used.sum())} points do not determine {undetermined}: give points that spread in "
            "depth and across the image, or fix more parameters of the lens."
        )
    parameters_by_step = np.zeros((len(columns), len(columns)))
    pose = Pose(np.asarray(problem.state.cam_from_rig)[0])
    parameters_by_step[: model.size, : model.size] = degrees_by_step(
        pose, parametrization.unit_mm, model
    )
    parameters_by_step[model.size :, model.size :] = np.diag(scale[rows])
    inverse = (vectors / values) @ vectors.T
    steps_by_error = (
        inverse @ jacobian.T @ full_jacobian[:, : len(scale)] @ (lens_errors / scale[:, None])
    )
    covariance = (
        parameters_by_step
        @ (noise**2 * inverse + steps_by_error @ steps_by_error.T)
        @ parameters_by_step.T
    )
    fitted_lens = straighten_lens(lens_of_index(problem, 0), type(promote_lens(lens.lens)))
    intrinsics = Intrinsics.of_lens(
        simplify_lens(fitted_lens), lens.image_size_px, lens.pixel_pitch_mm
    )
    notes = list(refutations_of_points(problem, names, model, lens_errors))
    status = Status.SUSPECT if notes else Status.CONVERGED
    if SKEW in names:
        row = parameters.index(SKEW)
        sigma_px = float(np.sqrt(covariance[row, row]))
        notes.append(sentences.skew_of_points(float(fitted_lens.skew_px), sigma_px))
    names_in_rig = tuple(f"{CAMERA}.{name}" for name in parameters)
    camera = Camera(intrinsics if names else lens, pose)
    return CalibrationResult(
        solution=Rig({CAMERA: camera}, parameters=names_in_rig, covariance=covariance),
        status={CAMERA: status},
        parameters=names_in_rig,
        values=_values(problem, pose, model, fitted_lens, names),
        covariance=covariance,
        fits={
            CAMERA: CameraFit(
                residuals_px=residuals_px,
                used=used,
                rank=len(columns),
                reduced_chi_square=noise**2,
                notes=tuple(notes),
                sigma_factor=noise,
            )
        },
        target=None,
        notes=tuple(notes),
        world="the frame of the points",
    )


def _values(
    problem: Problem, pose: Pose, model: PoseModel, lens: AbstractLens, names: Sequence[str]
) -> Float[np.ndarray, "p"]:
    """Values of the pose parameters, then of the lens parameters `names`, in degrees, mm and px,
    (p,).
    """
    pose_values = np.array(pose.model_parameters(model, pose))
    pose_values[:3] = np.degrees(pose_values[:3])
    lens_values = dict(zip(lens.parameter_names, np.asarray(lens.parameters), strict=True))
    return np.concatenate([pose_values, [float(lens_values.get(name, 0.0)) for name in names]])


def _check(
    points: np.ndarray,
    pixels: np.ndarray,
    lens: Intrinsics | None,
    image_size_px: tuple[int, int] | None,
    names: tuple[str, ...],
    tuning: CalibTuning,
) -> None:
    if points.ndim != 2 or points.shape[1:] != (3,) or pixels.shape != (len(points), 2):
        raise InputError(
            f"points_mm has shape {points.shape} and uv_px {pixels.shape}, but must be (n, 3) and "
            "(n, 2) for the same points."
        )
    if not (np.isfinite(points).all() and np.isfinite(pixels).all()):
        raise InputError(
            "A point or pixel is not finite: omit points that the image does not show."
        )
    if lens is None and image_size_px is None:
        raise InputError("The size of the image is missing: give lens or image_size_px.")
    lens_names = (SkewedThinPrism if lens is None else skew_lens(lens.lens)).parameter_names
    unknown = [name for name in names if name not in lens_names]
    if unknown:
        raise InputError(
            f"`free` names {unknown[0]!r}, but the lens has the parameters {', '.join(lens_names)}."
        )
    fewest = 4 if not names else tuning.answer.fewest_points
    if len(points) < fewest:
        raise InputError(f"{len(points)} points are too few: give at least {fewest}.")
    if lens is None and is_flat(points):
        raise InputError(
            "The points lie in one plane, which does not determine the lens: give `lens`, or "
            "points off the plane."
        )
