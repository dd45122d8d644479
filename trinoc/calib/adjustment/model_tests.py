"""Score tests of what one camera's fit holds fixed: aim, focal length, principal point, distortion.

Each alternative is one more unknown. The residuals show by how much it would reduce chi-square,
without another adjustment. An error that such a test misses may still move the camera by many of
its sigmas: W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic
Commission, 1968, calls the one internal and the other external reliability.
"""

import numpy as np
from jaxtyping import Float

from trinoc.calib.adjustment.adjustment import Adjustment
from trinoc.calib.problem.rao_test import HeldScore, score_of_residuals, unseen_sigmas
from trinoc.calib.result.calibration import Alternative

# numerical: columns of a lens and of a pose.
_FOCAL, _CENTRE, _RADIAL, _AIM = (0, 1), 2, 4, (4, 6)
# numerical: a change of the aspect leaves the mean of both focal lengths as it is.
_ASPECT = np.array([-0.5, 0.5])


def alternatives(adjustment: Adjustment, view: int) -> list[Alternative]:
    """Every alternative for one camera, the one that explains most of the residuals first."""
    problem, by_head = adjustment.problem, adjustment.whitened.jacobian[view]
    pose, aim_is_fixed = problem.slices.camera(view).start, adjustment.priors.aim_is_fixed
    columns = {"aim": by_head[:, pose + _AIM[0] : pose + _AIM[1]]} if aim_is_fixed else {}
    if adjustment.cameras[view].lens_factor is None:
        # A step of a lens that is exact is a change of one parameter.
        number = int(problem.parametrization.lens_of_camera[view])
        by_lens = by_head[:, problem.slices.lens(number)]
        by_lens = by_lens / problem.parametrization.lens_scale[number]
        focal = np.asarray(adjustment.lens(view).focal_length_px)
        columns["focal length"] = (by_lens[:, _FOCAL] @ focal)[:, None]
        columns["aspect"] = by_lens[:, _FOCAL] @ (focal * _ASPECT)[:, None]
        if not aim_is_fixed:
            # Where the aim is fixed, its test finds what displaces all circles alike.
            columns["principal point"] = by_lens[:, _CENTRE : _CENTRE + 2]
        columns["radial distortion"] = by_lens[:, _RADIAL : _RADIAL + 1]
    unit = {"aim": float(problem.parametrization.unit_mm)}
    base, residual = by_head[:, adjustment.free], adjustment.whitened.residual[view]
    tests, freedom = [], float(adjustment.freedom[view])
    for name, extra in columns.items():
        if freedom - extra.shape[1] >= 1:
            score = score_of_residuals(extra, residual, base, adjustment.root, freedom)
            tests.append(_test(name, extra, score, adjustment, view, unit.get(name, 1.0)))
    return sorted((test for test in tests if test is not None), key=lambda item: item.p_value)


def _test(
    name: str,
    extra: Float[np.ndarray, "n k"],
    score: HeldScore,
    adjustment: Adjustment,
    view: int,
    unit: float,
) -> Alternative | None:
    """Test of one alternative; None if the residuals cannot separate it from what is fitted."""
    test = score.judge(range(extra.shape[1]))
    if test.freedom < extra.shape[1]:
        return None
    # Places that scatter more than their sigmas scatter alike in every direction.
    test = test.with_noise(max(1.0, score.noise_variance(test)))
    sigma = unit * np.sqrt(np.diag(test.covariance))
    motion = motion_by_extra(extra, adjustment, view)
    by_pose = adjustment.pose_root(view) @ motion
    root = np.linalg.cholesky(test.covariance)
    # Of all changes that are found equally often, the one that moves the camera most.
    strains, worst = np.linalg.svd(by_pose @ root)[1:]
    tuning = adjustment.problem.tuning.answer
    sigmas = unseen_sigmas(tuning.chance, test.freedom, tuning.power)
    unseen_step = sigmas * root @ worst[0]
    unseen_step = unseen_step * np.sign(unseen_step[np.argmax(np.abs(unseen_step))])
    return Alternative(
        name=name,
        chi_square_drop=test.chi_square,
        p_value=test.chance,
        estimate=unit * test.step,
        sigma=sigma,
        sentence=_sentence(name, unit * test.step, sigma),
        strain=float(np.linalg.norm(by_pose @ test.step)),
        unseen=unit * unseen_step,
        unseen_strain=sigmas * float(strains[0]),
        unseen_motion=adjustment.degrees_by_step(view) @ motion @ unseen_step,
        tuning=tuning,
    )


def motion_by_extra(
    extra: Float[np.ndarray, "n k"], adjustment: Adjustment, view: int
) -> Float[np.ndarray, "p k"]:
    """Steps of a camera's pose by a unit of each unknown that is held fixed.

    R of `Adjustment.pose_root` times a step is its length in sigmas: the squared Mahalanobis
    distance of the pose is |R step|^2.
    """
    base = adjustment.whitened.jacobian[view][:, adjustment.free]
    step = -adjustment.covariance @ (base.T @ extra)
    return step[adjustment.rows(view)]


def _sentence(name: str, estimate: Float[np.ndarray, "k"], sigma: Float[np.ndarray, "k"]) -> str:
    if name == "aim":
        return (
            f"the optical axis misses the origin of the sheet by ({estimate[0]:.2f}, "
            f"{estimate[1]:.2f}) +- ({sigma[0]:.1g}, {sigma[1]:.1g}) mm: "
            'use pose_model="aim-free".'
        )
    if name == "focal length":
        return (
            f"the residuals look like a focal length {100 * estimate[0]:+.3f} +- "
            f"{100 * sigma[0]:.1g} % off: check the lens and its focus."
        )
    if name == "aspect":
        return (
            f"the residuals look like a focal length along v {100 * estimate[0]:+.3f} +- "
            f"{100 * sigma[0]:.1g} % off against that along u: check the pixel pitch."
        )
    if name == "principal point":
        return (
            f"the residuals look like a principal point ({estimate[0]:+.2g}, {estimate[1]:+.2g}) "
            f"+- ({sigma[0]:.1g}, {sigma[1]:.1g}) px off: see that the picture is not cut, and "
            "that the lens is this camera's."
        )
    return (
        f"the residuals look like radial distortion k1 = {estimate[0]:+.3f} +- {sigma[0]:.3f} "
        "that the lens does not hold: calibrate its intrinsics."
    )
