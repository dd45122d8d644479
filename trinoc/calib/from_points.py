"""One camera from points of known places, on a plane or off it, and their given images."""

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
from trinoc.calib.problem.problem import Problem, lens_number
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
    """The pose of a camera, and what of its lens is `free`, by least squares in the picture.

    points_mm : places in the world, four or more; off one plane where the lens is fitted too.
    uv_px : where the picture shows them, distorted as it is.
    lens : the intrinsics; without it `image_size_px` is needed, and the focal lengths and the
        principal point are fitted from a direct linear transform (Hartley and Zisserman, 7.1),
        with as many coefficients of Brown and Conrady's distortion, and with a skew, as the points
        ask for.
    free : names of the lens's parameters (fx_px, fy_px, cx_px, cy_px, skew_px, and its coefficients
        or those of a model that contains it) that are fitted, starting from `lens`.
    pose_model : "rigid", any motion; "aim-free", the same by pan, tilt, swing, distance and aim;
        or "aimed", for a camera whose axis meets the world's origin.
    systematics : its `lens_covariance` is that of what is not `free` of the lens, and is in the
        covariance; by default that of a data sheet where the lens is one (`Systematics.typical`).
        `Systematics()` takes the lens as exact. The places are exact either way.
    tuning : constants of calibration; a benchmark or a study changes them.

    The status is SUSPECT, with a note that names it, where the points ask for something of lens or
    aim that was held and said to be exact (Rao's score test, by noise as the residuals show it), or
    for a lens beyond four sigmas of what was said of it.

    Raises
    ------
    InputError : shapes, numbers or names that cannot be.
    CalibrationError : the points do not determine the camera, lie behind it (a left-handed
        frame), or the fit did not converge.
    """
    points = np.ascontiguousarray(real_array(points_mm, "points_mm"))
    seen = np.ascontiguousarray(real_array(uv_px, "uv_px"))
    model = PoseModel.of(pose_model)
    names = tuple((() if lens is not None else AFFINE_PARAMETERS) if free is None else free)
    _check(points, seen, lens, image_size_px, names, tuning)
    if lens is None:
        assert image_size_px is not None
        camera = find_linear_camera(points, seen, image_size_px)
    else:
        camera = Camera(lens, find_pose(points, seen, lens, tuning=tuning))
    problem = fit_without_outliers(problem_of_points(camera, points, seen, names, model, tuning))
    if lens is None and free is None:
        problem, names = extend_lens(problem, names)
    lenses = {CAMERA: camera.intrinsics} if lens else {}
    known = systematics or Systematics.typical(lenses, tuning=tuning)
    factor = known.lens_factors({CAMERA: camera.intrinsics}).get(CAMERA, np.zeros((0, 0)))
    held = np.zeros((problem.parametrization.lens_shape[1], factor.shape[1]))
    held[: len(factor)] = factor
    held[[name in names for name in problem.state.lenses.parameter_names]] = 0.0
    return _result(problem, names, model, camera.intrinsics, held)


def _result(
    problem: Problem,
    names: tuple[str, ...],
    model: PoseModel,
    lens: Intrinsics,
    held: Float[np.ndarray, "q r"],
) -> CalibrationResult:
    """held : change of the lens's parameters for a sigma of each error that is not fitted."""
    (view,), parametrization = problem.views, problem.parametrization
    used = view.used
    every = whiten_views(problem).jacobian[0][: 2 * len(used)][np.repeat(used, 2)]
    scale, pose_rows = np.asarray(parametrization.lens_scale)[0], parametrization.slices.camera(0)
    rows = [problem.state.lenses.parameter_names.index(name) for name in names]
    columns = [*range(pose_rows.start, pose_rows.start + model.size), *rows]
    parameters = (*model.parameter_names, *names)
    jacobian = every[:, columns]
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
    lost = (sigma > LARGEST_SIGMA) | (values < 1e-14 * values[-1])
    if lost.any():
        touched = (vectors[:, lost] ** 2).sum(axis=1) > 0.02
        open_ = ", ".join(name for name, hit in zip(parameters, touched, strict=True) if hit)
        raise CalibrationError(
            f"{int(used.sum())} points leave {open_} free: give points that spread in depth and "
            "across the picture, or hold more of the lens."
        )
    by_step = np.zeros((len(columns), len(columns)))
    pose = Pose(np.asarray(problem.state.cam_from_rig)[0])
    by_step[: model.size, : model.size] = degrees_by_step(pose, parametrization.unit_mm, model)
    by_step[model.size :, model.size :] = np.diag(scale[rows])
    inverse = (vectors / values) @ vectors.T
    by_error = inverse @ jacobian.T @ every[:, : len(scale)] @ (held / scale[:, None])
    covariance = by_step @ (noise**2 * inverse + by_error @ by_error.T) @ by_step.T
    found = straighten_lens(lens_number(problem, 0), type(promote_lens(lens.lens)))
    intrinsics = Intrinsics.of_lens(simplify_lens(found), lens.image_size_px, lens.pixel_pitch_mm)
    told = list(refutations_of_points(problem, names, model, held))
    status = Status.SUSPECT if told else Status.CONVERGED
    if SKEW in names:
        row = parameters.index(SKEW)
        sigma_px = float(np.sqrt(covariance[row, row]))
        told.append(sentences.skew_of_points(float(found.skew_px), sigma_px))
    names_in_rig = tuple(f"{CAMERA}.{name}" for name in parameters)
    solved = Camera(intrinsics if names else lens, pose)
    return CalibrationResult(
        solution=Rig({CAMERA: solved}, parameters=names_in_rig, covariance=covariance),
        status={CAMERA: status},
        parameters=names_in_rig,
        values=_values(problem, pose, model, found, names),
        covariance=covariance,
        fits={
            CAMERA: CameraFit(
                residuals_px=residuals_px,
                used=used,
                rank=len(columns),
                reduced_chi_square=noise**2,
                notes=tuple(told),
                sigma_factor=noise,
            )
        },
        target=None,
        notes=tuple(told),
        world="the frame of the points",
    )


def _values(
    problem: Problem, pose: Pose, model: PoseModel, lens: AbstractLens, names: Sequence[str]
) -> Float[np.ndarray, "p"]:
    """Values of the parameters of pose and lens, in degrees, mm and px."""
    of_pose = np.array(pose.model_parameters(model, pose))
    of_pose[:3] = np.degrees(of_pose[:3])
    every = dict(zip(lens.parameter_names, np.asarray(lens.parameters), strict=True))
    return np.concatenate([of_pose, [float(every.get(name, 0.0)) for name in names]])


def _check(
    points: np.ndarray,
    seen: np.ndarray,
    lens: Intrinsics | None,
    image_size_px: tuple[int, int] | None,
    names: tuple[str, ...],
    tuning: CalibTuning,
) -> None:
    if points.ndim != 2 or points.shape[1:] != (3,) or seen.shape != (len(points), 2):
        raise InputError(
            f"points_mm has shape {points.shape} and uv_px {seen.shape}, but must be (n, 3) and "
            "(n, 2), row for row the same points."
        )
    if not (np.isfinite(points).all() and np.isfinite(seen).all()):
        raise InputError("Some place or pixel is not finite: leave out points that were not seen.")
    if lens is None and image_size_px is None:
        raise InputError("Nothing says how large the picture is: give lens or image_size_px.")
    known = (SkewedThinPrism if lens is None else skew_lens(lens.lens)).parameter_names
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"`free` names {unknown[0]!r}, but knows {', '.join(known)}.")
    fewest = 4 if not names else tuning.answer.fewest_points
    if len(points) < fewest:
        raise InputError(f"{len(points)} points are too few: give at least {fewest}.")
    if lens is None and is_flat(points):
        raise InputError(
            "The points lie in one plane, which does not tell the lens: give `lens`, or points "
            "off the plane."
        )
