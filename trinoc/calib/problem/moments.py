"""Score test for shots whose images were not taken at one moment.

In a shot of n cameras the board has one pose. If each image had its own pose of the board, the
chi-square of the shot would fall by D = sum_v g_v^T H_v^-1 g_v - g^T H^-1 g, to first order. Here
g_v and H_v are gradient and information of the pose from image v, and g and H are their sums. For
images of one moment D has a chi-square distribution with 6 (n - 1) degrees of freedom, times the
variance factor of all residuals. If the board moved between the images, D is far larger than in
other shots. In the code, the excess of a shot is D per degree of freedom.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.reprojection import linearise
from trinoc.calib.problem.robust_fit import errors_px, whitened_errors
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, RigState
from trinoc.calib.problem.views import ObservationTable, shot_capacity
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: fewer shots have no typical value.
_FEWEST_SHOTS = 4


class UnsynchronisedImage(NamedTuple):
    """An image that shows the board at another pose than the other images of its shot.

    Attributes
    ----------
    view : index of the observation in `Problem.views`.
    excess : reduction of the shot's chi-square, per degree of freedom, if each of its images had
        its own board pose; relative to the typical value of all shots.
    """

    view: int
    excess: float


def find_unsynchronised_images(problem: Problem) -> list[UnsynchronisedImage]:
    """Find the images that were taken at another moment than the rest of their shot.

    As long as the images of a shot disagree, the image is removed without which the others agree
    best. Problems with several boards, and shots with one image, are not tested.

    problem : problem at the end of a robust fit.
    """
    images_by_shot, excess = _excesses(problem)
    excess_by_shot = {shot: excess(images) for shot, images in images_by_shot.items()}
    typical = max(_typical(images_by_shot, excess_by_shot), 1.0)
    if len(images_by_shot) < _FEWEST_SHOTS:
        return []
    unsynchronised = []
    for shot, images in images_by_shot.items():
        remaining, value = list(images), excess_by_shot[shot]
        while value > problem.tuning.problem.other_moment * typical:
            without = {k: excess([j for j in remaining if j != k]) for k in remaining}
            # Of two images either may be wrong: the first keeps the shot.
            worst = (
                remaining[-1]
                if len(remaining) == 2
                else min(without, key=lambda image: without[image])
            )
            unsynchronised.append(UnsynchronisedImage(worst, value / typical))
            remaining.remove(worst)
            value = without[worst]
    return unsynchronised


def typical_excess(problem: Problem) -> float:
    """Ratio that shows whether the cameras of a rig are synchronised; 1 if they are.

    D is the reduction of a shot's chi-square if each image had its own board pose. The ratio is the
    median over all shots of D per degree of freedom, divided by its median under noise. It is 0 if
    the problem has too few shots.
    """
    images_by_shot, excess = _excesses(problem)
    if len(images_by_shot) < _FEWEST_SHOTS:
        return 0.0
    return _typical(images_by_shot, {s: excess(images) for s, images in images_by_shot.items()})


def _typical(images_by_shot: dict[int, list[int]], excess_by_shot: dict[int, float]) -> float:
    """Median over all shots of a shot's excess, divided by the median of that excess under noise.

    Both dictionaries have the index of the shot as key.
    """
    ratios = []
    for shot, images in images_by_shot.items():
        freedom = POSE_SIZE * (len(images) - 1)
        # Wilson and Hilferty's median of a chi-square over its degrees of freedom.
        ratios.append(excess_by_shot[shot] / (1.0 - 2.0 / (9.0 * freedom)) ** 3)
    return float(np.median(ratios)) if ratios else 0.0


def _excesses(
    problem: Problem,
) -> tuple[dict[int, list[int]], Callable[[list[int]], float]]:
    """Images of each shot with several cameras, and a function that computes the excess of images.

    The excess is the reduction of chi-square, per degree of freedom, if each image had its own
    board pose. The function takes indices of images of one shot. The dictionary is empty for a
    problem with several boards.
    """
    if len(problem.state.set_from_board):
        return {}, lambda _: 0.0
    information, gradient = _pose_equations(problem)

    def excess(rows: list[int]) -> float:
        if len(rows) < 2:
            return 0.0
        gains = [_gain(information[k], gradient[k]) for k in rows]
        joint_gain = _gain(information[rows].sum(axis=0), gradient[rows].sum(axis=0))
        return (sum(gains) - joint_gain) / (POSE_SIZE * (len(rows) - 1))

    shots = images_of_shots(problem)
    return {shot: rows for shot, rows in shots.items() if len(rows) > 1}, excess


def images_of_shots(problem: Problem) -> dict[int, list[int]]:
    """Indices of the observations with used points, for each shot. The key is the index of the
    shot.
    """
    shots: dict[int, list[int]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            shots.setdefault(view.shot, []).append(k)
    return shots


def _pose_step(
    information: Float[np.ndarray, "*v 6 6"], gradient: Float[np.ndarray, "*v 6"]
) -> Float[np.ndarray, "*v 6"]:
    """Gauss-Newton step of a pose from its normal equations. Undetermined directions
    hardly change.
    """
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    scaled = information * scale[..., :, None] * scale[..., None, :] + 1e-9 * np.eye(POSE_SIZE)
    return -scale * np.linalg.solve(scaled, (gradient * scale)[..., None])[..., 0]


def _gain(information: Float[np.ndarray, "6 6"], gradient: Float[np.ndarray, "6"]) -> float:
    """Decrease of chi-square by the Gauss-Newton step of a pose."""
    return -float(gradient @ _pose_step(information, gradient))


def _pose_equations(
    problem: Problem,
) -> tuple[Float[np.ndarray, "v 6 6"], Float[np.ndarray, "v 6"]]:
    """Information and gradient of the board pose, from each of v images alone.

    A point has a small weight if its residual is much longer than the median residual of its image.
    The residuals of a whole image may be large: its weight does not change.
    """
    count = len(problem.views)
    whitened = whitened_errors(problem)
    scale = np.full(len(whitened), np.inf)
    for k, view in enumerate(problem.views):
        length = np.linalg.norm(whitened[k], axis=1)[: view.row_count][view.rows_used]
        if len(length):
            scale[k] = problem.tuning.problem.gate * max(float(np.median(length)), 1e-9)
    loss = GemanMcClure.from_scale(scale)
    parts = _by_view(problem.state, problem.parametrization, problem.table, loss)
    information, gradient = (np.asarray(part)[:count] for part in parts)
    return information, gradient


@kept_jit
def _by_view(
    state: RigState, parametrization: Parametrization, table: ObservationTable, loss: GemanMcClure
) -> tuple[Float[Array, "v 6 6"], Float[Array, "v 6"]]:
    def of_view(view: ObservationTable, view_loss: GemanMcClure) -> tuple[Array, Array]:
        information, gradient = linearise(state, parametrization, view).weigh(
            parametrization, view_loss
        )
        return information[-POSE_SIZE:, -POSE_SIZE:], gradient[-POSE_SIZE:]

    return jax.vmap(of_view)(table, loss)


class ImagePoses(NamedTuple):
    """Board pose that fits each of v images alone, as a small change of the pose of its shot.

    Attributes
    ----------
    step : (v, 6) change from the board pose of the shot to that of the image, in local coordinates.
    information : (v, 6, 6) information (inverse covariance) of `step`, for the present point
        sigmas.
    jacobian_px : (v, n, 2, 6) derivative of the pixels of the n board points with respect to the
        board pose.
    """

    step: Float[np.ndarray, "v 6"]
    information: Float[np.ndarray, "v 6 6"]
    jacobian_px: Float[np.ndarray, "v n 2 6"]


def fit_image_poses(problem: Problem) -> ImagePoses:
    """Fit the pose of the board to each image alone, by one Gauss-Newton step."""
    information, gradient = _pose_equations(problem)
    drawn_mm = [np.asarray(rows) for rows in problem.table.point_mm[: len(problem.views)]]
    jacobian_px = pose_jacobian_px(problem, drawn_mm)
    return ImagePoses(_pose_step(information, gradient), information, jacobian_px)


def pose_jacobian_px(
    problem: Problem, point_mm: Sequence[Float[np.ndarray, "_n 3"]]
) -> Float[np.ndarray, "v n 2 6"]:
    """Derivative of the pixels of board points with respect to the board pose of their shot, for
    each image.

    point_mm : (n, 3) points in each of v images, in the frame of the board.
    """
    count, table = len(problem.views), problem.table
    used = np.any(table.whitening != 0, axis=(-2, -1))
    identity = used[..., None, None] * np.eye(table.whitening.shape[-1])
    table_points_mm = np.array(table.point_mm)
    for k, rows in enumerate(point_mm):
        table_points_mm[k, : len(rows)] = rows
    table = table._replace(whitening=identity, point_mm=table_points_mm)
    return np.asarray(_pose_jacobian(problem.state, problem.parametrization, table))[:count]


@kept_jit
def _pose_jacobian(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> Float[Array, "v n 2 6"]:
    return jax.vmap(
        lambda view: linearise(state, parametrization, view).jacobian[..., -POSE_SIZE:]
    )(table)


def errors_about_image_poses_px(
    problem: Problem, poses: ImagePoses
) -> list[Float[np.ndarray, "_m 2"]]:
    """Residuals of each image, px, if the image had its own best board pose, to first order.

    They do not contain the motion of the board between the exposures of the cameras.
    """
    return [
        errors + jacobian[: len(errors)] @ step
        for errors, jacobian, step in zip(errors_px(problem), poses.jacobian_px, poses.step)
    ]


def pose_differences_px(
    problem: Problem, poses: ImagePoses
) -> dict[int, tuple[np.ndarray, Float[np.ndarray, "_s 2"]]]:
    """Shift of the board's image in each camera relative to the other cameras, in each shot.

    Let m be the mean motion of the board points of an image, px, if the board moved from the pose
    fitted to the shot to the pose fitted to this image alone. The shift is m of one camera minus
    the mean of m over the other cameras. It is small for synchronised cameras that did not move.

    Returns
    -------
    For each camera but the first (the key is its index): the indices of its s shots, and the
    shifts, (s, 2).
    """
    if len(problem.state.set_from_board):
        return {}
    shifts: dict[int, dict[int, np.ndarray]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            motion_px = poses.jacobian_px[k, : view.row_count] @ poses.step[k]
            shifts.setdefault(view.shot, {})[view.camera] = motion_px[view.rows_used].mean(axis=0)
    differences_of_camera = {}
    for camera in range(1, problem.cameras):
        shots = sorted(
            shot
            for shot, camera_shifts in shifts.items()
            if camera in camera_shifts and len(camera_shifts) > 1
        )
        if len(shots) >= _FEWEST_SHOTS:
            differences = [
                shifts[shot][camera]
                - np.mean(
                    [camera_shifts for c, camera_shifts in shifts[shot].items() if c != camera],
                    axis=0,
                )
                for shot in shots
            ]
            differences_of_camera[camera] = np.array(shots), np.array(differences)
    return differences_of_camera


def split_into_own_shots(problem: Problem, views: list[int]) -> Problem:
    """Problem in which each of the given observations has a new shot of its own, so that its board
    pose is free.

    views : indices of the observations. The new shots follow the existing ones, in this order.
    """
    boards = np.asarray(problem.state.rig_from_board)
    new_boards = boards[[problem.views[k].shot for k in views]]
    shots = problem.shots + len(views)
    spare_poses = np.broadcast_to(np.eye(3, 4), (shot_capacity(shots) - shots, 3, 4))
    rig_from_board = np.concatenate([boards[: problem.shots], new_boards, spare_poses])
    state = eqx.tree_at(lambda s: s.rig_from_board, problem.state, rig_from_board)
    members = list(problem.views)
    for position, k in enumerate(views):
        members[k] = members[k]._replace(shot=problem.shots + position)
    return problem._replace(views=tuple(members), state=state, shots=shots)
