"""Each camera by itself from the circles in its picture, and what they determine of it."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.adjustment.estimate import Adjustment, adjust_cameras
from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.robust_fit import errors_px, robust_scale
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.result.calibration import Status
from trinoc.calib.result.degrees import largest_sigmas, values_of_parameters
from trinoc.calib.starts.camera_start import plane_pose
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.projection import unproject_pixels
from trinoc.geometry.rig import PARAMETER_NAMES
from trinoc.numerics.information import observability
from trinoc.numerics.precision import as_numpy


class PoseEstimate(NamedTuple):
    """The pose of one camera with everything needed to judge it.

    Fields
    ------
    status : how the fit ended.
    values : (6,) pan, tilt, swing in degrees, distance, aim X, aim Y in mm; NaN unless the
        status is CONVERGED, so that no initial guess is ever read as a result.
    covariance : (p, p) of the first p values; NaN where a parameter is not determined.
    residuals_px : (m, 2) predicted minus observed centres.
    used : (m,) circles that took part; the others were located wrongly.
    rank : number of determined directions.
    reduced_chi_square : of the used circles; NaN without degrees of freedom.
    gauge : names of the parameters that are not determined.
    """

    status: Status
    values: Float[np.ndarray, "6"]
    covariance: Float[np.ndarray, "p p"]
    residuals_px: Float[np.ndarray, "m 2"]
    used: Bool[np.ndarray, "m"]
    rank: int
    reduced_chi_square: float
    gauge: tuple[str, ...]


def fit_camera(
    detection: Detection,
    pattern: Pattern,
    lens: Intrinsics,
    model: PoseModel,
    image: Float[np.ndarray, "h w"] | None = None,
) -> PoseEstimate:
    """The pose of one camera by its circles; `image` where its grey levels will be fitted, too."""
    rays = unproject_pixels(lens.lens, detection.centres_px)
    place_mm = pattern.centres_mm[detection.circle_index]
    planes = detection.lines_px @ np.asarray(lens.lens.matrix)
    best: Adjustment | None = None
    for start in (
        lambda: pose_of_crossed_lines(planes, rays[:, :2] / rays[:, 2:], place_mm),
        lambda: plane_pose(rays, place_mm),
    ):
        pose = start()
        if pose is None or not np.isfinite(np.asarray(pose.cam_from_world)).all():
            continue
        begin = pose if model is PoseModel.AIM_FREE else as_numpy(_aimed(pose))
        camera = SheetCamera("camera", detection, lens, None, begin, image)
        fit = adjust_cameras([camera], pattern, Systematics(), model, 0.0, first_damping=None)
        if best is None or _misfit(fit) < _misfit(best):
            best = fit
        if _misfit(best) < TUNING.adjustment.far_sigmas:
            break
    return _nothing(detection, model) if best is None else _estimate(best)


_aimed = jax.jit(lambda pose: pose.aim_at_origin())


def _misfit(fit: Adjustment) -> float:
    """Robust scale of the whitened residuals; infinite where there is no answer."""
    if not fit.converged or not np.isfinite(fit.near.residual).all():
        return np.inf
    return robust_scale(fit.near.residual[0].reshape(-1, 2)[: len(fit.used[0])])


def _estimate(fit: Adjustment) -> PoseEstimate:
    """Status, rank and covariance of a fit at the point where it ended."""
    view, parameters, count = fit.problem.views[0], fit.parameters(0), fit.model.size
    reduced = float(fit.reduced_chi_square[0])
    jacobian = fit.near.jacobian[0][:, fit.free[fit.rows(0)]]
    usable = fit.converged and bool(
        np.isfinite(parameters[:4]).all() and np.isfinite(jacobian).all()
    )
    if not (usable and parameters[3] > 0 and parameters[1] > 0):
        return _nothing(view.detection, fit.model)._replace(
            used=view.used, reduced_chi_square=reduced
        )
    largest = largest_sigmas(fit.model, float(parameters[3]))
    # What the circles determine is a matter of where they are, not of how badly they fit: a lens
    # that is off by its data sheet's sigma misfits a held aim by hundreds of sigmas.
    factor = float(fit.problem.sigma_factor[0])
    information = factor**2 * jacobian.T @ jacobian
    seen = observability(information, fit.degrees_by_step(0), largest)
    is_complete = seen.rank == count
    return PoseEstimate(
        Status.CONVERGED if is_complete else Status.RANK_DEFICIENT,
        values_of_parameters(parameters) if is_complete else np.full(6, np.nan),
        factor**2 * seen.covariance,
        errors_px(fit.problem)[0],
        view.used,
        seen.rank,
        reduced,
        tuple(PARAMETER_NAMES[k] for k in seen.gauge),
    )


def _nothing(detection: Detection, model: PoseModel) -> PoseEstimate:
    """The estimate of a camera whose fit did not converge: NaN throughout."""
    count = len(detection)
    return PoseEstimate(
        Status.NOT_CONVERGED,
        np.full(6, np.nan),
        np.full((model.size, model.size), np.nan),
        np.full((count, 2), np.nan),
        np.ones(count, dtype=bool),
        0,
        float("nan"),
        (),
    )


# numerical: steps of 7.5 degrees, after which the parabola through the best three is good to a
# degree or two.
_ANGLES_RAD = np.arange(48) * (2 * np.pi / 48)


def pose_of_crossed_lines(
    planes: Float[np.ndarray, "2 3"],
    slopes: Float[np.ndarray, "m 2"],
    place_mm: Float[np.ndarray, "m 2"],
) -> Pose | None:
    """The pose of the crossed lines whose circles lie nearest to the observed ones.

    planes : normals, in the camera's frame, of the planes of the lines along X and along Y.
    slopes : x/z and y/z of the ray to each circle. place_mm : the circles' centres.

    None where a line was not seen, or no such pose has the circles in front.
    """
    if not np.isfinite(planes).all():
        return None
    normal_x, normal_y = _unit(planes)
    ray = _unit(np.cross(normal_x, normal_y))
    ray = ray * np.sign(ray[2])

    def view_circle(
        angles_rad: Float[np.ndarray, "a"],
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        axes = _axes(normal_x, normal_y, ray, angles_rad)
        return axes, *_distance_and_misfit(axes, ray, slopes, place_mm)

    _, _, misfit = view_circle(_ANGLES_RAD)
    best = int(np.argmin(misfit))
    if not np.isfinite(misfit[best]):
        return None
    before, at, after = misfit[(best + np.array([-1, 0, 1])) % len(_ANGLES_RAD)]
    bend = before - 2 * at + after
    shift = (before - after) / (2 * bend) if np.isfinite(bend) and bend > 0 else 0.0
    (axes,), (distance_mm,), _ = view_circle(_ANGLES_RAD[best : best + 1] + shift * _ANGLES_RAD[1])
    return Pose(np.column_stack([axes, distance_mm * ray]))


def _axes(
    normal_x: Float[np.ndarray, "3"],
    normal_y: Float[np.ndarray, "3"],
    ray: Float[np.ndarray, "3"],
    angles_rad: Float[np.ndarray, "a"],
) -> Float[np.ndarray, "a 3 3"]:
    """Rotations from the sheet to the camera, X turned by each angle out of the ray to the
    crossing."""
    across = np.cross(normal_x, ray)
    axis_x = np.cos(angles_rad)[:, None] * ray + np.sin(angles_rad)[:, None] * across
    axis_y = _unit(np.cross(normal_y, axis_x))
    # The camera sees the sheet from above: Z points against the ray to the crossing.
    axis_y *= -np.sign(np.cross(axis_x, axis_y) @ ray)[:, None]
    return np.stack([axis_x, axis_y, np.cross(axis_x, axis_y)], axis=2)


def _distance_and_misfit(
    axes: Float[np.ndarray, "a 3 3"],
    ray: Float[np.ndarray, "3"],
    slopes: Float[np.ndarray, "m 2"],
    place_mm: Float[np.ndarray, "m 2"],
) -> tuple[Float[np.ndarray, "a"], Float[np.ndarray, "a"]]:
    """Of each rotation the distance that fits best in the plane of the picture, and the sum of
    squares it leaves; infinite where a circle lies behind."""
    offset = place_mm @ np.swapaxes(axes[:, :, :2], 1, 2)
    slope = ray[:2] - slopes * ray[2]
    target = slopes * offset[..., 2:] - offset[..., :2]
    distance_mm = np.sum(slope * target, axis=(1, 2)) / np.sum(slope * slope)
    points = offset + distance_mm[:, None, None] * ray
    in_front = (distance_mm > 0) & (points[..., 2] > 0).all(axis=1)
    depth = np.where(points[..., 2:] > 0, points[..., 2:], 1.0)
    misfit = np.sum((points[..., :2] / depth - slopes) ** 2, axis=(1, 2))
    return distance_mm, np.where(in_front, misfit, np.inf)


def _unit(vector: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)
