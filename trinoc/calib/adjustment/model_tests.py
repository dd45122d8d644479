"""Score tests of the parameters that the fit of a camera assumed exact.

These are aim, focal length, principal point and distortion. Each test predicts by how much
chi-square would fall if the parameter were estimated, without another fit. An error that the test
cannot detect may still move the camera by many of its sigmas. W. Baarda, "A testing procedure for
use in geodetic networks", Netherlands Geodetic Commission, 1968, calls this internal and external
reliability.
"""

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment
from trinoc.calib.problem.rao_test import FixedScore, detectable_sigmas, score_of_residuals
from trinoc.calib.result.calibration import FixedParameterTest

# numerical: columns of a lens and of a pose.
_FOCAL, _CENTRE, _RADIAL, _AIM = (0, 1), 2, 4, (4, 6)
# numerical: a change of the aspect leaves the mean of both focal lengths as it is.
_ASPECT = np.array([-0.5, 0.5])


def run_fixed_parameter_tests(adjustment: Adjustment, view: int) -> list[FixedParameterTest]:
    """Score tests of all fixed parameters of one camera's lens and aim. The smallest p-value comes
    first.
    """
    problem, by_parameters = adjustment.problem, adjustment.whitened.jacobian[view]
    pose, aim_is_fixed = problem.slices.camera(view).start, adjustment.priors.aim_is_fixed
    columns = {"aim": by_parameters[:, pose + _AIM[0] : pose + _AIM[1]]} if aim_is_fixed else {}
    if adjustment.cameras[view].lens_factor is None:
        # A step of a lens that is exact is a change of one parameter.
        lens_index = int(problem.parametrization.lens_of_camera[view])
        by_lens = by_parameters[:, problem.slices.lens(lens_index)]
        by_lens = by_lens / problem.parametrization.lens_scale[lens_index]
        focal = np.asarray(adjustment.lens(view).focal_length_px)
        columns["focal length"] = (by_lens[:, _FOCAL] @ focal)[:, None]
        columns["aspect"] = by_lens[:, _FOCAL] @ (focal * _ASPECT)[:, None]
        if not aim_is_fixed:
            # With a fixed aim, its test detects a common displacement of all circles.
            columns["principal point"] = by_lens[:, _CENTRE : _CENTRE + 2]
        columns["radial distortion"] = by_lens[:, _RADIAL : _RADIAL + 1]
    unit = {"aim": float(problem.parametrization.unit_mm)}
    base, residual = by_parameters[:, adjustment.free], adjustment.whitened.residual[view]
    tests, freedom = [], float(adjustment.freedom[view])
    for name, extra in columns.items():
        if freedom - extra.shape[1] >= 1:
            score = score_of_residuals(extra, residual, base, adjustment.root, freedom)
            tests.append(_test(name, extra, score, adjustment, view, unit.get(name, 1.0)))
    return sorted((test for test in tests if test is not None), key=lambda item: item.p_value)


def _test(
    name: str,
    extra: Float[np.ndarray, "n k"],
    score: FixedScore,
    adjustment: Adjustment,
    view: int,
    unit: float,
) -> FixedParameterTest | None:
    """Score test of one group of k fixed parameters.

    Returns None if the residuals cannot distinguish the group from the estimated parameters.

    Parameters
    ----------
    name : name of the group.
    extra : (n, k) derivative of the residuals with respect to the group.
    score : normal equations of the group.
    adjustment, view : adjustment, and index of the camera.
    unit : factor that converts the parameters of `extra` to their public unit.
    """
    test = score.test(range(extra.shape[1]))
    if test.freedom < extra.shape[1]:
        return None
    # Points that scatter more than their sigmas scatter equally in every direction.
    test = test.with_noise(max(1.0, score.noise_variance(test)))
    sigma = unit * np.sqrt(np.diag(test.covariance))
    motion = motion_by_extra(extra, adjustment, view)
    by_pose = adjustment.pose_root(view) @ motion
    root = np.linalg.cholesky(test.covariance)
    # The change that moves the camera most, of all changes with the same detection probability.
    strains, worst = np.linalg.svd(by_pose @ root)[1:]
    tuning = adjustment.problem.tuning.answer
    sigmas = detectable_sigmas(tuning.chance, test.freedom, tuning.power)
    unseen_step = sigmas * root @ worst[0]
    unseen_step = unseen_step * np.sign(unseen_step[np.argmax(np.abs(unseen_step))])
    return FixedParameterTest(
        name=name,
        chi_square_drop=test.chi_square,
        p_value=test.p_value,
        estimate=unit * test.step,
        sigma=sigma,
        strain=float(np.linalg.norm(by_pose @ test.step)),
        undetectable=unit * unseen_step,
        undetectable_strain=sigmas * float(strains[0]),
        undetectable_motion=adjustment.degrees_by_step(view) @ motion @ unseen_step,
        tuning=tuning,
    )


def motion_by_extra(
    extra: Float[np.ndarray, "n k"], adjustment: Adjustment, view: int
) -> Float[np.ndarray, "p k"]:
    """Change of one camera's estimated pose if one of k fixed parameters had an error of 1, (p, k).

    The change is in local coordinates of the pose. With R from `Adjustment.pose_root`, |R change|
    is the length of the change in sigmas (Mahalanobis distance).

    extra : (n, k) derivative of the residuals with respect to the fixed parameters.
    """
    base = adjustment.whitened.jacobian[view][:, adjustment.free]
    step = -adjustment.covariance @ (base.T @ extra)
    return step[adjustment.rows(view)]
