"""Fit of one camera alone to the circles in its image."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment, adjust
from trinoc.calib.detection.detection import Detection
from trinoc.calib.problem.robust_fit import robust_scale
from trinoc.calib.problem.sheet_problem import SheetCamera, SheetPriors
from trinoc.calib.result.calibration import Status
from trinoc.calib.starts.camera_start import plane_pose
from trinoc.calib.starts.crossed_lines import pose_of_crossed_lines
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import PoseModel
from trinoc.geometry.projection import unproject_pixels
from trinoc.numerics.information import Observability
from trinoc.numerics.precision import as_numpy


def fit_single_camera(
    detection: Detection,
    pattern: Pattern,
    lens: Intrinsics,
    model: PoseModel,
    image: Float[np.ndarray, "h w"] | None = None,
    tuning: CalibTuning = TUNING,
) -> Adjustment | None:
    """Fit one camera to its detected circles, with sheet and lens assumed exact.

    Returns None if no initial pose can be computed.

    model : estimated parameters of the pose.
    image : grey levels, if a later fit will use them; they are not used here.
    """
    rays = unproject_pixels(lens.lens, detection.centres_px)
    circle_mm = pattern.centres_mm[detection.circle_index]
    planes = detection.lines_px @ np.asarray(lens.lens.matrix)
    best: Adjustment | None = None
    for first_pose in (
        lambda: pose_of_crossed_lines(planes, rays[:, :2] / rays[:, 2:], circle_mm),
        lambda: plane_pose(rays, circle_mm),
    ):
        pose = first_pose()
        if pose is None or not np.isfinite(np.asarray(pose.cam_from_world)).all():
            continue
        start = pose if model is PoseModel.AIM_FREE else as_numpy(_aimed(pose))
        camera = SheetCamera("camera", detection, lens, None, start, image)
        fit = adjust(
            [camera], pattern, SheetPriors(model, Systematics(), tuning), first_damping=None
        )
        if best is None or _misfit(fit) < _misfit(best):
            best = fit
        if _misfit(best) < tuning.adjustment.far_sigmas:
            break
    return best


_aimed = jax.jit(lambda pose: pose.aim_at_origin())


def _misfit(fit: Adjustment) -> float:
    """Robust standard deviation of the whitened residuals; infinite if the fit did not converge."""
    if not fit.converged or not np.isfinite(fit.whitened.residual).all():
        return np.inf
    return robust_scale(fit.whitened.residual[0].reshape(-1, 2)[: len(fit.used[0])])


def observe_single_camera(fit: Adjustment | None) -> tuple[Status, Observability]:
    """Status of a fit from `fit_single_camera`, and the pose parameters that its
    circles determine.
    """
    nothing = Observability(0, np.zeros((0, 0)), ())
    if fit is None or not fit.converged:
        return Status.NOT_CONVERGED, nothing
    parameters, jacobian = fit.parameters(0), fit.whitened.jacobian[0][:, fit.free]
    is_finite = np.isfinite(parameters[:4]).all() and np.isfinite(jacobian).all()
    # Distance and tilt of a camera above the sheet are positive.
    if not (is_finite and parameters[3] > 0 and parameters[1] > 0):
        return Status.NOT_CONVERGED, nothing
    # The determined directions depend on the positions of the circles, not on the quality of the
    # fit: an error of the lens within its data sheet's sigma misfits a fixed aim by hundreds of
    # sigmas.
    observability = fit.observability(0, sigma_factor=float(fit.sigma_factors[0]))
    is_complete = observability.rank == fit.model.size
    return Status.CONVERGED if is_complete else Status.RANK_DEFICIENT, observability
