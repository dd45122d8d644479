"""One camera from points of known places, on a plane or off it, and their given images."""

from collections.abc import Sequence

import cv2
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.pose import DEGREES, PointFit, fit_points, image_shifts
from trinoc.calib.result import Status
from trinoc.calib.uncertainty import Systematics
from trinoc.errors import CalibrationError, InputError
from trinoc.geometry import (
    AFFINE_PARAMETERS,
    DEFAULT_DISTORTION,
    Camera,
    Intrinsics,
    Pose,
    PoseModel,
    promoted,
    simplified,
)
from trinoc.numerics import ArrayLike, in_float64

# A direction whose sigma exceeds this (rad, share of the distance or focal length) is free.
_LARGEST_SIGMA = 0.1
# Residuals beyond this many robust sigmas are of other points than they were said to be.
_OUTLIER_SIGMAS = 6.0
_CUTS = 4
_FEWEST_FOR_LENS = 8
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
    """

    camera: Camera
    status: Status
    parameters: tuple[str, ...] = eqx.field(static=True)
    covariance: Float[np.ndarray, "p p"]
    residuals_px: Float[np.ndarray, "n 2"]
    used: Bool[np.ndarray, "n"]
    noise_px: float = eqx.field(static=True)

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
        principal point are fitted from a direct linear transform (Hartley and Zisserman, 7.1).
    free : names of the lens's `parameter_names` (fx_px, fy_px, cx_px, cy_px, and its coefficients
        or for an ideal lens those of Brown-Conrady) that are fitted, starting from `lens`.
    pose_model : "rigid", any motion; "aim-free", the same by pan, tilt, swing, distance and aim;
        or "aimed", for a camera whose axis meets the world's origin.
    systematics : its `lens_covariance` is that of what is not `free` of the lens, and is in the
        covariance; by default that of a data sheet where the lens is one (`Systematics.typical`).
        `Systematics()` takes the lens as exact. The places are exact either way.

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
    start = promoted(camera.intrinsics.lens)
    chosen = np.array([name in names for name in start.parameter_names], dtype=np.float64)
    directions = np.diag(chosen * start.parameter_scales(camera.image_size_px))
    used = np.ones(len(points), dtype=bool)
    pose = camera.pose.aimed() if model is PoseModel.AIMED else camera.pose
    for _ in range(_CUTS):
        fit = fit_points(pose, start, directions, points, seen, used, model)
        if not fit.converged:
            raise CalibrationError(
                f"The fit to {int(used.sum())} points did not converge: check that the places, "
                "the pixels and the lens belong together."
            )
        far = np.linalg.norm(fit.residuals_px, axis=1)
        # The median of a Rayleigh distribution is 1.18 sigma.
        kept = far <= _OUTLIER_SIGMAS * np.median(far[used]) / 1.18 + 1e-9
        if np.array_equal(kept, used):
            break
        used = kept
    known = systematics or Systematics.typical({_CAMERA: camera.intrinsics} if lens else {})
    factor = known.lens_factors({_CAMERA: camera.intrinsics}).get(_CAMERA, np.zeros((0, 0)))
    held = np.zeros((len(start.parameter_names), factor.shape[1]))
    held[: len(factor)] = factor
    held *= (1 - chosen)[:, None]
    by_lens = np.asarray(image_shifts(fit.pose, fit.lens, held, points))
    return _judged(fit, used, names, model, camera.intrinsics, directions, by_lens)


def _judged(
    fit: PointFit,
    used: Bool[np.ndarray, "n"],
    names: tuple[str, ...],
    model: PoseModel,
    lens: Intrinsics,
    directions: Float[np.ndarray, "q q"],
    by_lens: Float[np.ndarray, "n 2 r"],
) -> PointsCalibration:
    """by_lens : shift of the images, in px, for a sigma of each error of the lens that is held."""
    rows = [fit.lens.parameter_names.index(name) for name in names]
    columns = [*range(model.size), *(model.size + row for row in rows)]
    parameters = (*model.parameter_names, *names)
    jacobian = fit.jacobian.reshape(-1, fit.jacobian.shape[2])[np.repeat(used, 2)][:, columns]
    freedom = len(jacobian) - len(columns)
    if freedom < 0:
        raise CalibrationError(
            f"{int(used.sum())} points do not determine {len(columns)} parameters: give more."
        )
    chi = float(np.sum(fit.residuals_px[used] ** 2))
    noise = float(np.sqrt(chi / freedom)) if freedom else float("nan")
    values, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    sigma = (noise if freedom else 1.0) / np.sqrt(np.maximum(values, 1e-300))
    lost = (sigma > _LARGEST_SIGMA) | (values < 1e-14 * values[-1])
    if lost.any():
        touched = (vectors[:, lost] ** 2).sum(axis=1) > 0.02
        open_ = ", ".join(name for name, hit in zip(parameters, touched, strict=True) if hit)
        raise CalibrationError(
            f"{int(used.sum())} points leave {open_} free: give points that spread in depth and "
            "across the picture, or hold more of the lens."
        )
    by_step = np.zeros((len(columns), len(columns)))
    by_step[: model.size, : model.size] = DEGREES[: model.size, None] * fit.d_parameters_d_delta
    by_step[model.size :, model.size :] = np.diag(np.diag(directions)[rows])
    inverse = (vectors / values) @ vectors.T
    by_error = inverse @ jacobian.T @ by_lens[used].reshape(len(jacobian), by_lens.shape[2])
    covariance = by_step @ (noise**2 * inverse + by_error @ by_error.T) @ by_step.T
    fitted = Intrinsics.of_lens(simplified(fit.lens), lens.image_size_px, lens.pixel_pitch_mm)
    return PointsCalibration(
        camera=Camera(fitted if names else lens, fit.pose),
        status=Status.CONVERGED,
        parameters=parameters,
        covariance=covariance,
        residuals_px=fit.residuals_px,
        used=used,
        noise_px=noise,
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
    known = (DEFAULT_DISTORTION if lens is None else promoted(lens.lens)).parameter_names
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InputError(f"`free` names {unknown[0]!r}, but knows {', '.join(known)}.")
    fewest = 4 if not names else _FEWEST_FOR_LENS
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
