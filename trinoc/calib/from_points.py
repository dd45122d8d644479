"""One camera from points of known places, on a plane or off it, and their given images."""

from collections.abc import Collection, Sequence

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.special import fdtrc

from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.information import compute_information, whiten_views
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.problem.rao_test import rao_test
from trinoc.calib.problem.robust_fit import errors_px, fit_places
from trinoc.calib.problem.sheet_problem import SheetCamera, sheet_problem
from trinoc.calib.result.degrees import degrees_by_step
from trinoc.calib.result.status import Status
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.lenses.abstract_lens import AFFINE_PARAMETERS
from trinoc.geometry.lenses.registry import DEFAULT_DISTORTION, promote_lens, simplify_lens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.information import LARGEST_SIGMA
from trinoc.numerics.precision import ArrayLike, in_float64

# numerical: rounds in which outliers are left out, few of which change something.
_CUTS = 4
# numerical: residuals of this size are rounding.
_ROUNDING_PX = 1e-7
_REFUTED = (
    "The points ask for another lens than was held: free {}, or see that places and pixels are "
    "those of one camera."
)
# Under which the one camera's lens goes to those who know cameras by name.
_CAMERA = "camera"


class PointsCalibration(eqx.Module):
    """A camera fitted to given correspondences.

    Fields
    ------
    camera : with pose and lens; its pan, tilt, swing, distance and aim follow from the pose.
    status : how the fit ended.
    parameters : rows of `covariance`: those of the pose model (for a rigid motion turns about the
        camera's own axes and the centre in the world), and those of the lens that were fitted.
    covariance : (p, p), degrees, mm, pixels.
    residuals_px : (n, 2) predicted minus observed.
    used : (n,) points that took part; the others lie beyond six robust sigmas.
    noise_px : standard deviation of a coordinate, from the residuals.
    notes : sentences on what the points say against what was held.
    """

    camera: Camera
    status: Status
    parameters: tuple[str, ...] = eqx.field(static=True)
    covariance: Float[np.ndarray, "p p"]
    residuals_px: Float[np.ndarray, "n 2"]
    used: Bool[np.ndarray, "n"]
    noise_px: float = eqx.field(static=True)
    notes: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def rms_px(self) -> float:
        """Root mean square length of the residuals of the points that took part."""
        return float(np.sqrt(np.mean(np.sum(self.residuals_px[self.used] ** 2, axis=1))))

    def sigma(self, parameter: str) -> float:
        """Standard deviation of one of `parameters`."""
        return float(np.sqrt(self.covariance.diagonal()[self.parameters.index(parameter)]))


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
) -> PointsCalibration:
    """The pose of a camera, and what of its lens is `free`, by least squares in the picture.

    points_mm : places in the world, four or more; off one plane where the lens is fitted too.
    uv_px : where the picture shows them, distorted as it is.
    lens : the intrinsics; without it `image_size_px` is needed, and the focal lengths and the
        principal point are fitted from a direct linear transform (Hartley and Zisserman, 7.1),
        with as many coefficients of Brown and Conrady's distortion as the points ask for.
    free : names of the lens's `parameter_names` (fx_px, fy_px, cx_px, cy_px, and its coefficients
        or for an ideal lens those of Brown-Conrady) that are fitted, starting from `lens`.
    pose_model : "rigid", any motion; "aim-free", the same by pan, tilt, swing, distance and aim;
        or "aimed", for a camera whose axis meets the world's origin.
    systematics : its `lens_covariance` is that of what is not `free` of the lens, and is in the
        covariance; by default that of a data sheet where the lens is one (`Systematics.typical`).
        `Systematics()` takes the lens as exact. The places are exact either way.

    The status is SUSPECT, with a note, where the points still ask for something of the lens that
    was held and said to be exact: an F test of the pull at it (Rao's score test).

    Raises
    ------
    InputError : shapes, numbers or names that cannot be.
    CalibrationError : the points do not determine the camera, lie behind it (a left-handed
        frame), or the fit did not converge.
    """
    points, seen = (np.ascontiguousarray(each, np.float64) for each in (points_mm, uv_px))
    model = PoseModel.of(pose_model)
    names = tuple((() if lens is not None else AFFINE_PARAMETERS) if free is None else free)
    _check(points, seen, lens, image_size_px, names)
    if lens is None:
        assert image_size_px is not None
        camera = _linear_camera(points, seen, image_size_px)
    else:
        camera = Camera(lens, _first_pose(points, seen, lens))
    problem = _without_outliers(_problem_of_points(camera, points, seen, names, model))
    if lens is None and free is None:
        problem, names = _free_distortion(problem, names)
    known = systematics or Systematics.typical({_CAMERA: camera.intrinsics} if lens else {})
    factor = known.lens_factors({_CAMERA: camera.intrinsics}).get(_CAMERA, np.zeros((0, 0)))
    held = np.zeros((problem.chart.lens_shape[1], factor.shape[1]))
    held[: len(factor)] = factor
    held[[name in names for name in problem.state.lenses.parameter_names]] = 0.0
    return _result(problem, names, model, camera.intrinsics, held)


def _free_distortion(problem: Problem, names: tuple[str, ...]) -> tuple[Problem, tuple[str, ...]]:
    """As many coefficients as the points ask for, and the names of all that is then free."""
    lenses, affine = problem.state.lenses, names
    for count in filter(None, lenses.coefficient_counts):
        if _chance_of_pull(problem, names) > TUNING.answer.chance:
            break
        names = (*affine, *lenses.coefficient_names[:count])
        every = np.ones(len(problem.views[0].used), dtype=bool)
        view = problem.views[0]._replace(used=every)
        problem = _without_outliers(_with_lens_free(problem._replace(views=(view,)), names))
    return problem, names


def _chance_of_pull(
    problem: Problem, names: Sequence[str], uncertain: Collection[str] = ()
) -> float:
    """The chance that noise alone pulls so much at what is held of the lens.

    names : of the lens's parameters that are fitted. uncertain : of those that are held, but not
    known exactly: they may pull. Noise is that of the residuals, whence an F test.
    """
    whole = problem.state.lenses.parameter_names
    information = compute_information(_with_lens_free(problem, whole))
    exact = {column for column, name in enumerate(whole) if name not in {*names, *uncertain}}
    test = rao_test(information, np.isin(information.free, list(exact)))
    residuals_px = errors_px(problem)[0][problem.views[0].used]
    squared, left = float(np.sum(residuals_px**2)), residuals_px.size - len(information.free)
    # What rounding leaves of exact points asks for nothing.
    if not test.freedom or left < 1 or squared < _ROUNDING_PX**2 * residuals_px.size:
        return 1.0
    unexplained = max(squared - test.chi_square, 1e-12 * squared)
    return float(fdtrc(test.freedom, left, test.chi_square / test.freedom / (unexplained / left)))


class _Points(AbstractTarget):
    """Places anywhere in space, under a name that nobody sees.

    Fields
    ------
    centres_mm : (n, 3).
    """

    name: str = eqx.field(static=True)
    centres_mm: Float[np.ndarray, "n 3"]
    radius_mm: Float[np.ndarray, "n"]


def _problem_of_points(
    camera: Camera,
    points_mm: Float[np.ndarray, "n 3"],
    uv_px: Float[np.ndarray, "n 2"],
    names: tuple[str, ...],
    model: PoseModel,
) -> Problem:
    """One camera that sees the points, each to a pixel; the lens's `names` are free."""
    count = len(points_mm)
    unit = np.broadcast_to(np.eye(2), (count, 2, 2))
    no_lines = np.full((2, 3), np.nan)
    seen = Detection(np.arange(count), uv_px, unit, unit, no_lines, camera.image_size_px)
    pose = camera.pose.aim_at_origin() if model is PoseModel.AIMED else camera.pose
    target = _Points("points", points_mm, np.zeros(count))
    one = SheetCamera(_CAMERA, seen, camera.intrinsics, None, pose)
    problem = sheet_problem([one], target, Systematics(), model, aim_sigma_mm=0.0)
    return _with_lens_free(problem, names)


def _with_lens_free(problem: Problem, names: Collection[str]) -> Problem:
    """The problem with these of the one lens's parameters free."""
    free = np.array(problem.chart.free)
    free[: problem.chart.lens_shape[1]] = [
        name in names for name in problem.state.lenses.parameter_names
    ]
    return problem._replace(chart=eqx.tree_at(lambda c: c.free, problem.chart, free))


def _without_outliers(problem: Problem) -> Problem:
    """The problem where its fit ends, without points that are not those that they are said to be.

    Raises CalibrationError where it does not.
    """
    (view,) = problem.views
    for _ in range(_CUTS):
        problem, converged = fit_places(problem._replace(views=(view,)))
        pose = Pose(np.asarray(problem.state.cam_from_rig)[0])
        in_front = (problem.target.centres_mm @ pose.rotation[2] + pose.translation_mm[2]) > 0
        if not (converged and in_front[view.used].all()):
            raise CalibrationError(
                f"The fit to {int(view.used.sum())} points did not converge: check that the "
                "places, the pixels and the lens belong together."
            )
        far = np.linalg.norm(errors_px(problem)[0], axis=1)
        # The median of a Rayleigh distribution is 1.18 sigma.
        kept = far <= TUNING.problem.gate * np.median(far[view.used]) / 1.18 + 1e-9
        if np.array_equal(kept, view.used):
            break
        view = view._replace(used=kept)
    return problem


def _result(
    problem: Problem,
    names: tuple[str, ...],
    model: PoseModel,
    lens: Intrinsics,
    held: Float[np.ndarray, "q r"],
) -> PointsCalibration:
    """held : change of the lens's parameters for a sigma of each error that is not fitted."""
    (view,), chart = problem.views, problem.chart
    used = view.used
    every = whiten_views(problem).jacobian[0][: 2 * len(used)][np.repeat(used, 2)]
    scale, pose_rows = np.asarray(chart.lens_scale)[0], chart.camera_rows(0)
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
    by_step[: model.size, : model.size] = degrees_by_step(pose, chart.unit_mm, model)
    by_step[model.size :, model.size :] = np.diag(scale[rows])
    inverse = (vectors / values) @ vectors.T
    by_error = inverse @ jacobian.T @ every[:, : len(scale)] @ (held / scale[:, None])
    covariance = by_step @ (noise**2 * inverse + by_error @ by_error.T) @ by_step.T
    found = simplify_lens(lens_number(problem, 0))
    intrinsics = Intrinsics.of_lens(found, lens.image_size_px, lens.pixel_pitch_mm)
    every_name = problem.state.lenses.parameter_names
    uncertain = [name for name, row in zip(every_name, held, strict=True) if row.any()]
    refuted = _chance_of_pull(problem, names, uncertain) < TUNING.answer.chance
    exact = [name for name in every_name if name not in {*names, *uncertain}]
    return PointsCalibration(
        camera=Camera(intrinsics if names else lens, pose),
        status=Status.SUSPECT if refuted else Status.CONVERGED,
        parameters=parameters,
        covariance=covariance,
        residuals_px=residuals_px,
        used=used,
        noise_px=noise,
        notes=(_REFUTED.format(", ".join(exact)),) if refuted else (),
    )


def _check(
    points: np.ndarray,
    seen: np.ndarray,
    lens: Intrinsics | None,
    image_size_px: tuple[int, int] | None,
    names: tuple[str, ...],
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
    known = (DEFAULT_DISTORTION if lens is None else promote_lens(lens.lens)).parameter_names
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"`free` names {unknown[0]!r}, but knows {', '.join(known)}.")
    fewest = 4 if not names else TUNING.answer.fewest_points
    if len(points) < fewest:
        raise InputError(f"{len(points)} points are too few: give at least {fewest}.")
    if lens is None and _is_flat(points):
        raise InputError(
            "The points lie in one plane, which does not tell the lens: give `lens`, or points "
            "off the plane."
        )


def _is_flat(points: Float[np.ndarray, "n 3"]) -> bool:
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[2] < 1e-6 * spread[0])


def _first_pose(
    points: Float[np.ndarray, "n 3"], seen: Float[np.ndarray, "n 2"], lens: Intrinsics
) -> Pose:
    """By SQPnP (Terzakis and Lourakis 2020), on a plane and off it."""
    rays = np.asarray(jax.vmap(lens.normalised_from_pixel)(jnp.asarray(seen)))
    try:
        good, turn, shift = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP)
    except cv2.error as error:  # of points that are all one
        raise CalibrationError(
            f"The {len(points)} points do not spread enough to tell a pose: give points that "
            "spread in depth and across the picture."
        ) from error
    if not good:
        raise CalibrationError(
            f"No pose sees the {len(points)} points in front of the camera: check that places "
            "and pixels belong together, and that the frame of the places is right-handed."
        )
    return Pose(np.concatenate([cv2.Rodrigues(turn)[0], shift.reshape(3, 1)], axis=1))


def _linear_camera(
    points: Float[np.ndarray, "n 3"], seen: Float[np.ndarray, "n 2"], size_px: tuple[int, int]
) -> Camera:
    """The direct linear transform, both sides normalised."""
    middle, spread = points.mean(axis=0), points.std()
    centre, width = seen.mean(axis=0), seen.std()
    unit = np.concatenate([(points - middle) / spread, np.ones((len(points), 1))], axis=1)
    x, y = ((seen - centre) / width).T
    zero = np.zeros_like(unit)
    rows = np.concatenate(
        [
            np.concatenate([unit, zero, -x[:, None] * unit], axis=1),
            np.concatenate([zero, unit, -y[:, None] * unit], axis=1),
        ]
    )
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    to_world = np.diag([1 / spread] * 3 + [1.0])
    to_world[:3, 3] = -middle / spread
    from_unit = np.array([[width, 0, centre[0]], [0, width, centre[1]], [0, 0, 1]])
    camera = Camera.from_matrix(from_unit @ matrix @ to_world, size_px)
    depth = points @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3]
    if np.median(depth) <= 0:
        raise CalibrationError(
            "The points are seen behind the camera: the frame of their places is left-handed; "
            "turn one axis round."
        )
    # A real sensor has no skew.
    lens = camera.intrinsics
    straight = Intrinsics(
        focal_length_px=np.asarray(lens.focal_length_px),
        principal_point_px=np.asarray(lens.principal_point_px),
        image_size_px=size_px,
    )
    return Camera(straight, camera.pose)
