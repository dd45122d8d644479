"""Each camera by itself from the circles in its picture, and what they determine of it."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.adjustment.crossed_lines import pose_of_crossed_lines
from trinoc.calib.adjustment.estimate import Adjustment, adjust_cameras
from trinoc.calib.detection import Detection
from trinoc.calib.problem.robust_fit import errors_px, robust_scale
from trinoc.calib.problem.sheet_problem import SheetCamera
from trinoc.calib.result import Status
from trinoc.calib.result.degrees import largest_sigmas, values_of_parameters
from trinoc.calib.starts.camera_start import plane_pose
from trinoc.calib.targets import Pattern
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import PARAMETER_NAMES, Intrinsics, PoseModel, unproject_pixels
from trinoc.numerics import as_numpy, observability

# Another start may do better where most circles lie farther off, in sigmas.
_FAR = 10.0


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


def fit_cameras(
    detections: Sequence[Detection],
    pattern: Pattern,
    lenses: Sequence[Intrinsics],
    model: PoseModel,
) -> list[PoseEstimate]:
    """One pose for each picture, the sheet and the lens as they are said to be.

    Pictures whose crossed lines were seen start from them, the others from their circles.
    """
    return [
        fit_camera(detection, pattern, lens, model)
        for detection, lens in zip(detections, lenses, strict=True)
    ]


def fit_camera(
    detection: Detection, pattern: Pattern, lens: Intrinsics, model: PoseModel
) -> PoseEstimate:
    """The pose of one camera."""
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
        camera = SheetCamera("camera", detection, lens, None, begin)
        fit = adjust_cameras([camera], pattern, Systematics(), model, 0.0, first_damping=None)
        if best is None or _misfit(fit) < _misfit(best):
            best = fit
        if _misfit(best) < _FAR:
            break
    return _nothing(detection, model) if best is None else _estimate(best)


_aimed = jax.jit(lambda pose: pose.aimed())


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
    """What is known of a camera whose fit did not end."""
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
