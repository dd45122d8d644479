"""Cameras that do not look at one moment: the pose of the board differs within each shot.

A board that moves while cameras without a common trigger look at it is observed in slightly
different poses. One pose for all images of a shot would bend the lenses of all cameras. Therefore

1. lenses and board are fitted with a pose of the board for each image (`with_images_apart`), as
   for each camera alone;
2. the poses of the cameras follow from the shots, with the motion between the moments as a random
   effect (`with_motion_between_images`): a small step m of the board's pose in each image, of
   covariance M, the same for all images. Eliminated, it adds J M J^T to the covariance of an
   image's places, with J their derivative by the pose. The pose of one camera from another is then
   a mean over the shots, with a sigma by its scatter.

M is half the covariance of the differences between the poses of two images of a shot, less that
which the noise of their places gives to these differences. Source: S. R. Searle, G. Casella,
C. E. McCulloch, "Variance Components" (1992), chapter 4.
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
    typical_excess,
    with_shots_of_their_own,
)
from trinoc.calib.problem.problem import Problem, with_head_free
from trinoc.calib.problem.robust_fit import (
    RobustFit,
    drop_wrong_places,
    end_of_fit,
    finish_fit,
    fit_places,
)
from trinoc.calib.problem.variables import POSE_SIZE, step_motion
from trinoc.calib.problem.views import SheetPoints, View

# numerical: rounds in which the cameras' poses and the covariance of the motion follow each other.
_ROUNDS = 3
# numerical: the least variance of a motion, over the largest one.
_LEAST_SHARE = 1e-6
# numerical: a pair of images counts at most with so many times the median squared difference.
_MOST_INFLUENCE = 9.0


def with_images_apart(fit: RobustFit) -> RobustFit | None:
    """Fit lenses and board with a pose of the board for each image, and the cameras held.

    Returns None where the cameras look at one moment.
    """
    problem = fit.problem
    if any(view.shown is not None for view in problem.views):
        return None
    excess = typical_excess(problem)
    if excess == 0.0:
        return None
    poses = fit_image_poses(problem)
    used = [k for k, view in enumerate(problem.views) if view.used.any()]
    noise = float(np.median(_reduced_chi_square(problem, poses)[used]))
    if excess < problem.tuning.problem.moments_differ * noise:
        return None
    # Places that were right for one pose of the shot may be wrong for that of their image.
    problem, elsewhere = drop_wrong_places(problem, _errors_in_sigmas(problem, poses))
    later_images = [k for images in images_of_shots(problem).values() for k in images[1:]]
    apart = with_shots_of_their_own(problem, later_images)
    free = np.array(apart.free)
    free[apart.slices.cameras] = 0.0
    apart, _ = fit_places(with_head_free(apart, free))
    return finish_fit(apart, [*fit.elsewhere, *elsewhere])


def with_motion_between_images(apart_fit: RobustFit, shots_fit: RobustFit) -> RobustFit | None:
    """Find the cameras from the shots, the motion between the images of a shot a random effect.

    Parameters
    ----------
    apart_fit : with a pose of the board for each image; it gives lenses, board and sigmas.
    shots_fit : with one pose for each shot; the cameras begin there.

    Returns None where no shot has two images left that take part: they would not show the motion.
    """
    apart, shots = apart_fit.problem, shots_fit.problem
    state = eqx.tree_at(
        lambda state: (state.cam_from_rig, state.rig_from_board),
        apart.state,
        (shots.state.cam_from_rig, shots.state.rig_from_board),
    )
    views_in_shots = tuple(
        view._replace(shot=shot_view.shot)
        for view, shot_view in zip(apart.views, shots.views, strict=True)
    )
    free = np.array(apart.free)
    cameras = apart.slices.cameras
    free[cameras] = np.asarray(shots.free)[cameras]
    only_cameras = np.zeros_like(free)
    only_cameras[cameras] = free[cameras]
    uncorrelated = apart._replace(state=state, views=views_in_shots, shots=shots.shots)
    if all(len(images) < 2 for images in images_of_shots(uncorrelated).values()):
        return None
    uncorrelated, converged = fit_places(with_head_free(uncorrelated, only_cameras))
    for _ in range(_ROUNDS):
        correlated, converged = fit_places(_with_motion(uncorrelated))
        uncorrelated = uncorrelated._replace(state=correlated.state)
    # Lenses and board are not fitted again: the correlations were computed for these lenses, and
    # would pull them back to where they are.
    end = with_head_free(_with_motion(uncorrelated), free)
    converged = converged and apart_fit.converged
    return end_of_fit(end, converged, apart_fit.elsewhere)._replace(is_held=True)


def _errors_in_sigmas(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "v n 2"]:
    """Residuals of each image about its own pose, in sigmas as they were detected."""
    table = problem.table
    errors = np.zeros(np.shape(table.uv_px))
    for k, about_pose in enumerate(errors_about_image_poses_px(problem, poses)):
        errors[k, : len(about_pose)] = _sigma_multiplier(problem, problem.views[k]) * about_pose
    return np.einsum("vnij,vnj->vni", table.whitening, errors)


def _sigma_multiplier(problem: Problem, view: View) -> float:
    """By how much the sigmas of an image's places are multiplied."""
    return float(problem.sigma_factor[view.camera]) * view.sigma_ratio


def _reduced_chi_square(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "v"]:
    """Chi-square of each image about its own pose, by the sigmas as they are, over its degrees of
    freedom."""
    squared = np.sum(_errors_in_sigmas(problem, poses) ** 2, axis=(1, 2))
    return np.array(
        [
            chi_square / max(view.numbers - POSE_SIZE, 1) / _sigma_multiplier(problem, view) ** 2
            for chi_square, view in zip(squared, problem.views)
        ]
    )


def _with_motion(problem: Problem) -> Problem:
    """The problem with the errors of an image's places correlated by the motion of its board.

    The places are taken where the pose of their image has them, and the motion is taken off again
    to first order: so they stay right where lenses and cameras change.
    """
    poses = fit_image_poses(problem)
    motion = _motion_covariance(problem, poses)
    moved = [
        _moved_places_mm(problem, view, step)
        for view, step in zip(problem.views, poses.step, strict=True)
    ]
    jacobian_px = pose_jacobian_px(problem, moved)
    views = []
    for view, place_mm, jacobian, step in zip(
        problem.views, moved, jacobian_px, poses.step, strict=True
    ):
        if not view.used.any():
            views.append(view)
            continue
        uv_px = view.detection.centres_px + jacobian[: view.rows] @ step
        whitening = _correlated_whitening(view, _sigma_multiplier(problem, view), jacobian, motion)
        # The table divides by the camera's factor.
        shown = SheetPoints(place_mm, uv_px, whitening * problem.sigma_factor[view.camera])
        views.append(view._replace(shown=shown, sigma_ratio=1.0, is_moved=True))
    return problem._replace(views=tuple(views))


def _moved_places_mm(
    problem: Problem, view: View, step: Float[np.ndarray, "6"]
) -> Float[np.ndarray, "m 3"]:
    """Places of an image's board, moved within the frame of the shot's board as its pose is."""
    from_board = np.asarray(problem.state.rig_from_board[view.shot])
    after = np.asarray(step_motion(from_board, step, problem.parametrization.unit_mm))
    drawn_mm = problem.target.centres_mm[view.detection.circle_index]
    drawn_mm = np.pad(drawn_mm, ((0, 0), (0, 3 - drawn_mm.shape[1])))
    return (drawn_mm @ after[:, :3].T + after[:, 3] - from_board[:, 3]) @ from_board[:, :3]


def _correlated_whitening(
    view: View,
    factor: float,
    jacobian_px: Float[np.ndarray, "n 2 6"],
    motion: Float[np.ndarray, "6 6"],
) -> Float[np.ndarray, "k k"]:
    """W with W^T W the inverse of noise and motion together; 0 for places that take no part."""
    rows = np.flatnonzero(view.used)
    covariance = np.zeros((2 * len(rows), 2 * len(rows)))
    for number, row in enumerate(rows):
        place = slice(2 * number, 2 * number + 2)
        covariance[place, place] = factor**2 * view.detection.covariance_px2[row]
    jacobian = jacobian_px[rows].reshape(-1, POSE_SIZE)
    covariance += jacobian @ motion @ jacobian.T
    whitening = np.zeros((2 * view.rows, 2 * view.rows))
    numbers = np.stack([2 * rows, 2 * rows + 1], axis=1).ravel()
    whitening[np.ix_(numbers, numbers)] = np.linalg.inv(np.linalg.cholesky(covariance))
    return whitening


def _motion_covariance(problem: Problem, poses: ImagePoses) -> Float[np.ndarray, "6 6"]:
    """Covariance M of the motion of the board in one image, in steps of its pose.

    The influence of pairs that differ most is bounded.
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
    kept = np.maximum(values, _LEAST_SHARE * max(float(values[-1]), 1e-12))
    return (vectors * kept) @ vectors.T * np.outer(scale, scale)
