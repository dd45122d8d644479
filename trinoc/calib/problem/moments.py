"""Shots whose cameras did not see the board at one moment, by a score test at the end of a fit.

In a shot of n cameras the board has one pose. Were it free in each image, the chi-square of the
shot would fall by D = sum_v g_v^T H_v^-1 g_v - g^T H^-1 g, to first order, where g_v and H_v are
gradient and information of the pose by the residuals of image v, and g and H their sums. For
images of one moment D has a chi-square law with 6 (n - 1) degrees of freedom, times the factor by
which all residuals exceed their sigmas. A board that moved makes D far larger than in other shots.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float

from trinoc.calib.problem.places import linearise
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.robust_fit import errors_px, place_errors_in_sigmas
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, RigState
from trinoc.calib.problem.views import ViewTable, shot_capacity
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: fewer shots do not show what is usual.
_FEWEST_SHOTS = 4


class OtherMoment(NamedTuple):
    """An image that shows the board elsewhere than the other cameras of its shot.

    Fields
    ------
    view : its index.
    excess : D over its degrees of freedom, in units of what is usual among the shots.
    """

    view: int
    excess: float


def find_other_moments(problem: Problem) -> list[OtherMoment]:
    """Images to be taken out of their shots, at the end of a robust fit.

    From a flagged shot of three and more cameras, the image is taken whose removal makes the others
    agree best. A board of several, or a shot of one camera, is not tested.
    """
    images_by_shot, excess = _excesses(problem)
    excess_by_shot = {shot: excess(images) for shot, images in images_by_shot.items()}
    usual = max(_typical(images_by_shot, excess_by_shot), 1.0)
    if len(images_by_shot) < _FEWEST_SHOTS:
        return []
    others = []
    for shot, images in images_by_shot.items():
        remaining, value = list(images), excess_by_shot[shot]
        while value > problem.tuning.problem.other_moment * usual:
            without = {k: excess([j for j in remaining if j != k]) for k in remaining}
            # Of two images either may be the other one: the first keeps the shot.
            worst = (
                remaining[-1]
                if len(remaining) == 2
                else min(without, key=lambda image: without[image])
            )
            others.append(OtherMoment(worst, value / usual))
            remaining.remove(worst)
            value = without[worst]
    return others


def typical_excess(problem: Problem) -> float:
    """D over its degrees of freedom, in the median of the shots, over that of noise alone: 1 where
    the cameras look at one moment and the sigmas are right; 0 where too few shots show it."""
    images_by_shot, excess = _excesses(problem)
    if len(images_by_shot) < _FEWEST_SHOTS:
        return 0.0
    return _typical(images_by_shot, {s: excess(images) for s, images in images_by_shot.items()})


def _typical(images_by_shot: dict[int, list[int]], excess_by_shot: dict[int, float]) -> float:
    """Median of the shots' excesses, each over the median that its law has under noise alone."""
    ratios = []
    for shot, images in images_by_shot.items():
        freedom = POSE_SIZE * (len(images) - 1)
        # Wilson and Hilferty's median of a chi-square over its degrees of freedom.
        ratios.append(excess_by_shot[shot] / (1.0 - 2.0 / (9.0 * freedom)) ** 3)
    return float(np.median(ratios)) if ratios else 0.0


def _excesses(
    problem: Problem,
) -> tuple[dict[int, list[int]], Callable[[list[int]], float]]:
    """(the images of each shot of several cameras, D over its degrees of freedom for some images).

    Of a board of several there are no shots to compare.
    """
    if len(problem.state.set_from_board):
        return {}, lambda _: 0.0
    information, gradient = _pose_equations(problem)

    def excess(rows: list[int]) -> float:
        if len(rows) < 2:
            return 0.0
        gains = [_gain(information[k], gradient[k]) for k in rows]
        together = _gain(information[rows].sum(axis=0), gradient[rows].sum(axis=0))
        return (sum(gains) - together) / (POSE_SIZE * (len(rows) - 1))

    shots = images_of_shots(problem)
    return {shot: rows for shot, rows in shots.items() if len(rows) > 1}, excess


def images_of_shots(problem: Problem) -> dict[int, list[int]]:
    """Indices of the images that take part, by shot."""
    shots: dict[int, list[int]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            shots.setdefault(view.shot, []).append(k)
    return shots


def _pose_step(
    information: Float[np.ndarray, "*v 6 6"], gradient: Float[np.ndarray, "*v 6"]
) -> Float[np.ndarray, "*v 6"]:
    """Gauss-Newton step of a pose; directions that nothing determines stay nearly at rest."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
    scaled = information * scale[..., :, None] * scale[..., None, :] + 1e-9 * np.eye(POSE_SIZE)
    return -scale * np.linalg.solve(scaled, (gradient * scale)[..., None])[..., 0]


def _gain(information: Float[np.ndarray, "6 6"], gradient: Float[np.ndarray, "6"]) -> float:
    """Decrease of chi-square by the step of a pose."""
    return -float(gradient @ _pose_step(information, gradient))


def _pose_equations(
    problem: Problem,
) -> tuple[Float[np.ndarray, "v 6 6"], Float[np.ndarray, "v 6"]]:
    """Information and gradient of the pose of each image's board.

    A place that lies far off where most of its own image lie was located wrongly, and is weighted
    down: the image as a whole may lie anywhere.
    """
    count = len(problem.views)
    whitened = place_errors_in_sigmas(problem)
    scale = np.full(len(whitened), np.inf)
    for k, view in enumerate(problem.views):
        length = np.linalg.norm(whitened[k], axis=1)[: view.rows][view.kept]
        if len(length):
            scale[k] = problem.tuning.problem.gate * max(float(np.median(length)), 1e-9)
    loss = GemanMcClure.from_scale(scale)
    parts = _by_view(problem.state, problem.parametrization, problem.table, loss)
    information, gradient = (np.asarray(part)[:count] for part in parts)
    return information, gradient


@kept_jit
def _by_view(
    state: RigState, parametrization: Parametrization, table: ViewTable, loss: GemanMcClure
) -> tuple[Float[Array, "v 6 6"], Float[Array, "v 6"]]:
    def of_view(view: ViewTable, own: GemanMcClure) -> tuple[Array, Array]:
        information, gradient = linearise(state, parametrization, view).weigh(parametrization, own)
        return information[-POSE_SIZE:, -POSE_SIZE:], gradient[-POSE_SIZE:]

    return jax.vmap(of_view)(table, loss)


class ImagePoses(NamedTuple):
    """Poses of the board that fit each of v images alone, to first order.

    Fields
    ------
    step : (v, 6) from the pose of the shot to that which fits the image alone.
    information : (v, 6, 6) of the step, by the sigmas as they are.
    jacobian_px : (v, n, 2, 6) change of the places' pixels by the step.
    """

    step: Float[np.ndarray, "v 6"]
    information: Float[np.ndarray, "v 6 6"]
    jacobian_px: Float[np.ndarray, "v n 2 6"]


def fit_image_poses(problem: Problem) -> ImagePoses:
    """Fit the pose of the board to each image alone, by one Gauss-Newton step."""
    information, gradient = _pose_equations(problem)
    drawn_mm = [np.asarray(rows) for rows in problem.table.place_mm[: len(problem.views)]]
    jacobian_px = pose_jacobian_px(problem, drawn_mm)
    return ImagePoses(_pose_step(information, gradient), information, jacobian_px)


def pose_jacobian_px(
    problem: Problem, place_mm: Sequence[Float[np.ndarray, "_n 3"]]
) -> Float[np.ndarray, "v n 2 6"]:
    """Change of the pixels of given places of the board by steps of its pose, of each image."""
    count, table = len(problem.views), problem.table
    used = np.any(table.whitening != 0, axis=(-2, -1))
    plain = used[..., None, None] * np.eye(table.whitening.shape[-1])
    places = np.array(table.place_mm)
    for k, rows in enumerate(place_mm):
        places[k, : len(rows)] = rows
    table = table._replace(whitening=plain, place_mm=places)
    return np.asarray(_pose_jacobian(problem.state, problem.parametrization, table))[:count]


@kept_jit
def _pose_jacobian(
    state: RigState, parametrization: Parametrization, table: ViewTable
) -> Float[Array, "v n 2 6"]:
    return jax.vmap(
        lambda view: linearise(state, parametrization, view).jacobian[..., -POSE_SIZE:]
    )(table)


def errors_about_image_poses_px(
    problem: Problem, poses: ImagePoses
) -> list[Float[np.ndarray, "_m 2"]]:
    """Residuals of each image about its own pose, without what moments differ by."""
    return [
        errors + jacobian[: len(errors)] @ step
        for errors, jacobian, step in zip(errors_px(problem), poses.jacobian_px, poses.step)
    ]


def pose_differences_px(
    problem: Problem, poses: ImagePoses
) -> dict[int, tuple[np.ndarray, Float[np.ndarray, "_s 2"]]]:
    """For each camera but the first (shots, shifts in px of the board's image).

    A shift is the mean motion of the board's places in this camera, were its pose that which fits
    the image alone, less the mean of the other cameras of the shot. It is small where they look at
    one moment.
    """
    if len(problem.state.set_from_board):
        return {}
    shifts: dict[int, dict[int, np.ndarray]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            moved = poses.jacobian_px[k, : view.rows] @ poses.step[k]
            shifts.setdefault(view.shot, {})[view.camera] = moved[view.kept].mean(axis=0)
    answer = {}
    for camera in range(1, problem.cameras):
        shots = sorted(shot for shot, each in shifts.items() if camera in each and len(each) > 1)
        if len(shots) >= _FEWEST_SHOTS:
            differences = [
                shifts[shot][camera]
                - np.mean([each for c, each in shifts[shot].items() if c != camera], axis=0)
                for shot in shots
            ]
            answer[camera] = np.array(shots), np.array(differences)
    return answer


def with_shots_of_their_own(problem: Problem, views: list[int]) -> Problem:
    """The problem with these views in new shots behind the others, in the order given."""
    boards = np.asarray(problem.state.rig_from_board)
    own = boards[[problem.views[k].shot for k in views]]
    shots = problem.shots + len(views)
    more = np.broadcast_to(np.eye(3, 4), (shot_capacity(shots) - shots, 3, 4))
    rig_from_board = np.concatenate([boards[: problem.shots], own, more])
    state = eqx.tree_at(lambda s: s.rig_from_board, problem.state, rig_from_board)
    members = list(problem.views)
    for number, k in enumerate(views):
        members[k] = members[k]._replace(shot=problem.shots + number)
    return problem._replace(views=tuple(members), state=state, shots=shots)
