"""Cameras that do not look at one moment: the pose of the board differs within each shot.

A board that moves while cameras without a common trigger look at it is seen in slightly different
poses. Fitted as one pose, this bends the lenses of all cameras. The motion between the moments is
therefore a random effect: a small step m of the board's pose in each image, of covariance M, which
is the same for all images. Eliminated, it adds J M J^T to the covariance of an image's places, with
J their derivative by the pose. The shape within an image then determines its lens as it does for
one camera alone, and the pose of one camera from another is the mean over the shots, with a sigma
by its scatter.

M is estimated from the differences between the poses that the images of a shot have apart, less
what their noise makes of them. Source: S. R. Searle, G. Casella, C. E. McCulloch, "Variance
Components" (1992), chapter 4.
"""

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import compute_information
from trinoc.calib.problem.moments import (
    OwnPoses,
    errors_with_own_poses_px,
    images_of_shots,
    own_poses,
    typical_excess,
)
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import (
    RobustFit,
    drop_wrong_places,
    refit,
)
from trinoc.calib.problem.variables import POSE_SIZE
from trinoc.calib.problem.views import SheetPoints, View
from trinoc.calib.tuning.every_group import TUNING

# numerical: rounds in which residuals and the motion's covariance follow each other, and the
# relative change of the cameras' factors at the end; the smallest share of the largest variance of
# a motion; shots that count at most with so many times the median.
_MOST_ROUNDS, _SETTLED, _LEAST_SHARE, _LARGEST = 6, 0.03, 1e-6, 9.0


def with_moments_apart(fit: RobustFit) -> tuple[RobustFit, dict[int, float]]:
    """Estimate the motion of the board between the moments of a shot, as a random effect.

    Returns
    -------
    The fit, and by camera the factor of its corners' sigmas by the residuals about its own poses;
    the fit as it was and no factors where the cameras look at one moment.
    """
    problem = fit.problem
    if any(view.shown is not None for view in problem.views):
        return fit, {}
    excess = typical_excess(problem)
    if excess == 0.0:
        return fit, {}
    used = [k for k, view in enumerate(problem.views) if view.used.any()]
    noise = float(np.median(_noise_of_images(problem, own_poses(problem))[used]))
    if excess < TUNING.problem.moments_differ * noise:
        return fit, {}
    # Places that were right for one pose of the shot may be wrong for that of their image.
    problem, elsewhere = drop_wrong_places(
        problem, _own_errors_in_sigmas(problem, own_poses(problem))
    )
    elsewhere = [*fit.elsewhere, *elsewhere]
    fitted, factors = fit, {}
    for _ in range(_MOST_ROUNDS):
        last = factors
        own = own_poses(problem)
        noise = _noise_of_images(problem, own)
        factors = _camera_factors(problem, noise)
        motion = _motion_covariance(problem, own, noise)
        correlated = [
            _with_motion(problem, k, own.jacobian_px[k], noise[k], motion)
            for k in range(len(problem.views))
        ]
        ones = np.ones_like(problem.sigma_factor)
        fitted = refit(problem._replace(views=tuple(correlated), sigma_factor=ones), elsewhere)
        # The next round starts with independent places at the new state.
        problem = problem._replace(state=fitted.problem.state)
        if last and all(abs(factors[c] / last[c] - 1) < _SETTLED for c in factors):
            break
    before, after = (compute_information(each.problem).observability.rank for each in (fit, fitted))
    # Where the images alone hardly determine the lenses, what the cameras share is kept.
    return (fitted, factors) if fitted.converged and after >= before else (fit, {})


def _camera_factors(problem: Problem, noise: Float[np.ndarray, "v"]) -> dict[int, float]:
    """Scatter of each camera's places about its own poses, in sigmas as they were detected."""
    variances: dict[int, list[float]] = {}
    for view, variance in zip(problem.views, noise.tolist(), strict=True):
        if view.used.any():
            factor = float(problem.sigma_factor[view.camera]) * view.sigma_ratio
            variances.setdefault(view.camera, []).append(variance * factor**2)
    return {camera: float(np.sqrt(np.mean(own))) for camera, own in variances.items()}


def _own_errors_in_sigmas(problem: Problem, own: OwnPoses) -> Float[np.ndarray, "v n 2"]:
    """Residuals of each image about its own pose, in sigmas as they were detected."""
    table = problem.table
    errors = np.zeros(np.shape(table.uv_px))
    for k, each in enumerate(errors_with_own_poses_px(problem, own)):
        errors[k, : len(each)] = each
    errors = np.einsum("vnij,vnj->vni", table.whitening, errors)
    for k, view in enumerate(problem.views):
        errors[k] *= problem.sigma_factor[view.camera] * view.sigma_ratio
    return errors


def _noise_of_images(problem: Problem, own: OwnPoses) -> Float[np.ndarray, "v"]:
    """Variance of each image's residuals about its own pose, in squared sigmas as they are."""
    squared = np.sum(_own_errors_in_sigmas(problem, own) ** 2, axis=(1, 2))
    noise = np.ones(len(problem.views))
    for k, view in enumerate(problem.views):
        if view.used.any():
            freedom = max(view.numbers - POSE_SIZE, 1)
            factor = problem.sigma_factor[view.camera] * view.sigma_ratio
            noise[k] = max(float(squared[k]), 1e-12) / freedom / factor**2
    return noise


def _motion_covariance(
    problem: Problem, own: OwnPoses, noise: Float[np.ndarray, "v"]
) -> Float[np.ndarray, "6 6"]:
    """Covariance of the motion of the board in one image, in steps of its pose.

    Half of that of the difference of two images of a shot, shots that differ most bounded.
    """
    differences, noises = [], []
    for rows in images_of_shots(problem).values():
        for k in rows[1:]:
            differences.append(own.step[k] - own.step[rows[0]])
            pair = [k, rows[0]]
            inverse = np.linalg.pinv(own.information[pair], hermitian=True)
            noises.append(np.einsum("j,jpq->pq", noise[pair], inverse))
    steps = np.array(differences)
    scale = np.sqrt(np.median(steps**2, axis=0)) / 0.6745 + 1e-12
    length = np.sum((steps / scale) ** 2, axis=1)
    weight = np.minimum(1.0, _LARGEST * np.median(length) / np.maximum(length, 1e-12))
    total = (steps * weight[:, None]).T @ steps / np.sum(weight)
    excess = 0.5 * (total - np.mean(noises, axis=0))
    values, vectors = np.linalg.eigh(excess / np.outer(scale, scale))
    kept = np.maximum(values, _LEAST_SHARE * max(float(values[-1]), 1e-12))
    return (vectors * kept) @ vectors.T * np.outer(scale, scale)


def _with_motion(
    problem: Problem,
    k: int,
    jacobian_px: Float[np.ndarray, "n 2 6"],
    noise: float,
    motion: Float[np.ndarray, "6 6"],
) -> View:
    """An image of which the errors of all places are correlated by the motion of its board."""
    view = problem.views[k]
    if not view.used.any():
        return view._replace(sigma_ratio=1.0)
    detection = view.detection
    rows = np.flatnonzero(view.used)
    factor = problem.sigma_factor[view.camera] * view.sigma_ratio
    covariance = np.zeros((2 * len(rows), 2 * len(rows)))
    for number, row in enumerate(rows):
        own = slice(2 * number, 2 * number + 2)
        covariance[own, own] = noise * factor**2 * detection.covariance_px2[row]
    jacobian = jacobian_px[rows].reshape(-1, POSE_SIZE)
    covariance += jacobian @ motion @ jacobian.T
    whitening = np.zeros((2 * view.rows, 2 * view.rows))
    numbers = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    whitening[np.ix_(numbers, numbers)] = root
    places_mm = problem.target.centres_mm[detection.circle_index]
    shown = SheetPoints(places_mm, detection.centres_px, whitening)
    return view._replace(shown=shown, sigma_ratio=1.0)
