"""Fit of unsynchronised cameras: the pose of the board differs between the images of a shot.

Cameras without a common trigger observe a moving board at slightly different poses. One pose for
all images of a shot would distort the lenses of all cameras. Therefore:

1. Lenses and board are fitted with a pose of the board for each image (`fit_images_apart`), as for
   each camera alone.
2. The poses of the cameras are estimated from the shots, with the motion of the board between the
   images as a random effect (`fit_with_motion`). This motion is a small change m of the board pose
   in each image, with the same covariance M for all images. Its elimination adds J M J^T to the
   covariance of an image's points, where J is their derivative with respect to the pose. The
   relative pose of two cameras is then a mean over the shots, with a sigma from their scatter.

M is half the covariance of the pose differences between two images of a shot, minus the part from
the noise of their points. Source: S. R. Searle, G. Casella, C. E. McCulloch, "Variance Components"
(1992), chapter 4.
"""

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.moments import (
    ImagePoses,
    errors_about_image_poses_px,
    fit_image_poses,
    images_of_shots,
    pose_jacobian_px,
    split_into_own_shots,
    typical_excess,
)
from trinoc.calib.problem.problem import Problem, with_free_parameters
from trinoc.calib.problem.robust_fit import (
    RobustFit,
    drop_wrong_points,
    end_of_fit,
    finish_fit,
    fit_points,
)
from trinoc.calib.problem.variables import POSE_SIZE, step_motion
from trinoc.calib.problem.views import BoardObservation, SheetPoints

# numerical: rounds that alternate the cameras' poses and the covariance of the motion.
_ROUNDS = 3
# numerical: the least variance of a motion, over the largest one.
_LEAST_SHARE = 1e-6
# numerical: largest squared difference of a pair of images, relative to the median.
_MOST_INFLUENCE = 9.0


def fit_images_apart(fit: RobustFit) -> RobustFit | None:
    """Fit lenses and board shape, with a separate board pose for each image and fixed camera poses.

    Returns None if the cameras are synchronised, or if grey levels are used.
    """
    problem = fit.problem
    if any(view.grey_level_points is not None for view in problem.views):
        return None
    excess = typical_excess(problem)
    if excess == 0.0:
        return None
    poses = fit_image_poses(problem)
    used = [k for k, view in enumerate(problem.views) if view.used.any()]
    noise = float(np.median(_reduced_chi_square(problem, poses)[used]))
    if excess < problem.tuning.problem.moments_differ * noise:
        return None
    # Inliers for the pose of the shot may be outliers for that of their image.
    problem, rejected = drop_wrong_points(problem, _errors_in_sigmas(problem, poses))
    later_images = [k for images in images_of_shots(problem).values() for k in images[1:]]
    images_problem = split_into_own_shots(problem, later_images)
    free = np.array(images_problem.free)
    free[images_problem.slices.cameras] = 0.0
    images_problem, _ = fit_points(with_free_parameters(images_problem, free))
    return finish_fit(images_problem, [*fit.rejected_images, *rejected])


def fit_with_motion(images_fit: RobustFit, shots_fit: RobustFit) -> RobustFit | None:
    """Estimate camera poses from shots in which the board moves between the exposures.

    The motion of the board is a random effect: it adds a correlated error to the points of each
    image. Its covariance is estimated from the shots.

    Parameters
    ----------
    images_fit : fit with a separate board pose for each image; gives lenses, board shape and
        sigmas.
    shots_fit : fit with one board pose for each shot; gives the initial camera poses.

    Returns
    -------
    The fit. None if no shot has two used images, so that the motion cannot be estimated.
    """
    images_problem, shots = images_fit.problem, shots_fit.problem
    state = eqx.tree_at(
        lambda state: (state.cam_from_rig, state.rig_from_board),
        images_problem.state,
        (shots.state.cam_from_rig, shots.state.rig_from_board),
    )
    views_in_shots = tuple(
        view._replace(shot=shot_view.shot)
        for view, shot_view in zip(images_problem.views, shots.views, strict=True)
    )
    free = np.array(images_problem.free)
    cameras = images_problem.slices.cameras
    free[cameras] = np.asarray(shots.free)[cameras]
    only_cameras = np.zeros_like(free)
    only_cameras[cameras] = free[cameras]
    uncorrelated = images_problem._replace(state=state, views=views_in_shots, shots=shots.shots)
    if all(len(images) < 2 for images in images_of_shots(uncorrelated).values()):
        return None
    uncorrelated, converged = fit_points(with_free_parameters(uncorrelated, only_cameras))
    for _ in range(_ROUNDS):
        correlated, converged = fit_points(_with_motion(uncorrelated))
        uncorrelated = uncorrelated._replace(state=correlated.state)
    # Lenses and board are not fitted again: the correlations were computed for these lenses and
    # would bias them toward their present values.
    end = with_free_parameters(_with_motion(uncorrelated), free)
    converged = converged and images_fit.converged
    return end_of_fit(end, converged, images_fit.rejected_images)._replace(lenses_fixed=True)


def _errors_in_sigmas(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "v n 2"]:
    """Residuals of each image about its own best board pose, in units of the detected sigmas, (v,
    n, 2).

    The sigma factors are not applied.
    """
    table = problem.table
    errors = np.zeros(np.shape(table.uv_px))
    for k, about_pose in enumerate(errors_about_image_poses_px(problem, poses)):
        errors[k, : len(about_pose)] = _sigma_multiplier(problem, problem.views[k]) * about_pose
    return np.einsum("vnij,vnj->vni", table.whitening, errors)


def _sigma_multiplier(problem: Problem, view: BoardObservation) -> float:
    """Factor by which the detected sigmas of an image's points are multiplied."""
    return float(problem.sigma_factor[view.camera]) * view.sigma_ratio


def _reduced_chi_square(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "v"]:
    """Reduced chi-square of each image about its own best board pose, with the present sigmas,
    (v,).
    """
    squared = np.sum(_errors_in_sigmas(problem, poses) ** 2, axis=(1, 2))
    return np.array(
        [
            chi_square
            / max(view.coordinate_count - POSE_SIZE, 1)
            / _sigma_multiplier(problem, view) ** 2
            for chi_square, view in zip(squared, problem.views)
        ]
    )


def _with_motion(problem: Problem) -> Problem:
    """Problem in which the motion of the board between exposures correlates the errors of an
    image's points.

    Residuals are linearised at the board pose that fits the image alone. To first order, they are
    residuals relative to the board pose of the shot, also after lenses and cameras change.
    """
    poses = fit_image_poses(problem)
    motion = _motion_covariance(problem, poses)
    moved_points_mm = [
        _moved_points_mm(problem, view, step)
        for view, step in zip(problem.views, poses.step, strict=True)
    ]
    jacobian_px = pose_jacobian_px(problem, moved_points_mm)
    views = []
    for view, image_points_mm, jacobian, step in zip(
        problem.views, moved_points_mm, jacobian_px, poses.step, strict=True
    ):
        if not view.used.any():
            views.append(view)
            continue
        uv_px = view.detection.centres_px + jacobian[: view.row_count] @ step
        whitening = _correlated_whitening(view, _sigma_multiplier(problem, view), jacobian, motion)
        # The table divides by the camera's factor.
        points = SheetPoints(image_points_mm, uv_px, whitening * problem.sigma_factor[view.camera])
        views.append(
            view._replace(grey_level_points=points, sigma_ratio=1.0, has_motion_errors=True)
        )
    return problem._replace(views=tuple(views))


def _moved_points_mm(
    problem: Problem, view: BoardObservation, step: Float[np.ndarray, "6"]
) -> Float[np.ndarray, "m 3"]:
    """Detected board points, (m, 3) in mm, at the board pose of their own image.

    They are given in the frame of the board at the pose of the shot.

    step : change from the board pose of the shot to that of the image, in local coordinates.
    """
    from_board = np.asarray(problem.state.rig_from_board[view.shot])
    after = np.asarray(step_motion(from_board, step, problem.parametrization.unit_mm))
    drawn_mm = problem.target.centres_mm[view.detection.circle_index]
    drawn_mm = np.pad(drawn_mm, ((0, 0), (0, 3 - drawn_mm.shape[1])))
    return (drawn_mm @ after[:, :3].T + after[:, 3] - from_board[:, 3]) @ from_board[:, :3]


def _correlated_whitening(
    view: BoardObservation,
    factor: float,
    jacobian_px: Float[np.ndarray, "n 2 6"],
    motion: Float[np.ndarray, "6 6"],
) -> Float[np.ndarray, "k k"]:
    """Whitening matrix W of an image's points: W^T W is the inverse covariance of noise plus
    motion. Rows of unused points are 0.

    factor : factor by which the detected sigmas are multiplied.
    jacobian_px : derivative of the pixels with respect to the board pose.
    motion : covariance of the board's motion.
    """
    rows = np.flatnonzero(view.used)
    covariance = np.zeros((2 * len(rows), 2 * len(rows)))
    for position, row in enumerate(rows):
        block = slice(2 * position, 2 * position + 2)
        covariance[block, block] = factor**2 * view.detection.covariance_px2[row]
    jacobian = jacobian_px[rows].reshape(-1, POSE_SIZE)
    covariance += jacobian @ motion @ jacobian.T
    whitening = np.zeros((2 * view.row_count, 2 * view.row_count))
    coordinates = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
    whitening[np.ix_(coordinates, coordinates)] = np.linalg.inv(np.linalg.cholesky(covariance))
    return whitening


def _motion_covariance(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "6 6"]:
    """Covariance, (6, 6), of the random motion of the board between the exposures of a shot.

    It is the covariance of the board pose in one image relative to the pose of the shot, in local
    coordinates. It is estimated from the pose differences between images of a shot, minus the noise
    of these poses. Pairs of images with large differences have a bounded weight.
    """
    differences, noises = [], []
    for first, *others in images_of_shots(problem).values():
        for k in others:
            differences.append(poses.step[k] - poses.step[first])
            pair = [k, first]
            noises.append(np.linalg.pinv(poses.information[pair], hermitian=True).sum(axis=0))
    steps = np.array(differences)
    scale = np.sqrt(np.median(steps**2, axis=0)) / 0.6745 + 1e-12
    length = np.sum((steps / scale) ** 2, axis=1)
    weight = np.minimum(1.0, _MOST_INFLUENCE * np.median(length) / np.maximum(length, 1e-12))
    weight /= np.sum(weight)
    total = (steps * weight[:, None]).T @ steps
    excess = 0.5 * (total - np.einsum("j,jpq->pq", weight, np.array(noises)))
    values, vectors = np.linalg.eigh(excess / np.outer(scale, scale))
    positive = np.maximum(values, _LEAST_SHARE * max(float(values[-1]), 1e-12))
    return (vectors * positive) @ vectors.T * np.outer(scale, scale)
