"""Shots whose cameras did not see the board at one moment, by a score test at the end of a fit.

In a shot of n cameras the board has one pose. Were it free in each image, the chi-square of the
shot would fall by D = sum_v g_v^T H_v^-1 g_v - g^T H^-1 g, to first order, where g_v and H_v are
gradient and information of the pose by the residuals of image v, and g and H their sums. For
images of one moment D has a chi-square law with 6 (n - 1) degrees of freedom, times the factor by
which all residuals exceed their sigmas. A board that moved makes D far larger than in other shots.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.calib.problem.places import linearise
from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.problem.variables import POSE_SIZE, Chart, RigState
from trinoc.calib.problem.views import ViewTable, shot_capacity
from trinoc.calib.tuning.every_group import TUNING
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.geometry.projection import project_points
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: the median of a chi-square of 6 degrees of freedom over these.
_MEDIAN = 0.891
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
    if len(problem.state.set_from_board):
        return []
    information, gradient = (
        np.asarray(part)[: len(problem.views)]
        for part in _by_view(problem.state, problem.chart, problem.table)
    )
    members: dict[int, list[int]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            members.setdefault(view.shot, []).append(k)
    shots = {shot: rows for shot, rows in members.items() if len(rows) > 1}

    def excess(rows: list[int]) -> float:
        if len(rows) < 2:
            return 0.0
        gains = [_gain(information[k], gradient[k]) for k in rows]
        together = _gain(information[rows].sum(axis=0), gradient[rows].sum(axis=0))
        return (sum(gains) - together) / (POSE_SIZE * (len(rows) - 1))

    by_shot = {shot: excess(rows) for shot, rows in shots.items()}
    if len(by_shot) < _FEWEST_SHOTS:
        return []
    usual = max(float(np.median(list(by_shot.values()))) / _MEDIAN, 1.0)
    others = []
    for shot, rows in shots.items():
        left, value = list(rows), by_shot[shot]
        while value > TUNING.problem.other_moment * usual:
            without = {k: excess([j for j in left if j != k]) for k in left}
            # Of two images either may be the other one: the first keeps the shot.
            worst = left[-1] if len(left) == 2 else min(without, key=lambda k: without[k])
            others.append(OtherMoment(worst, value / usual))
            left.remove(worst)
            value = without[worst]
    return others


def _gain(information: Float[np.ndarray, "6 6"], gradient: Float[np.ndarray, "6"]) -> float:
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale) + 1e-9 * np.eye(POSE_SIZE)
    return float(gradient * scale @ np.linalg.solve(scaled, gradient * scale))


@kept_jit
def _by_view(
    state: RigState, chart: Chart, table: ViewTable
) -> tuple[Float[Array, "v 6 6"], Float[Array, "v 6"]]:
    """Information and gradient of the pose of each view's board."""
    plain = GemanMcClure.from_scale(jnp.asarray(jnp.inf))

    def of_view(view: ViewTable) -> tuple[Array, Array]:
        information, gradient = linearise(state, chart, view).weigh(chart, plain)
        return information[-POSE_SIZE:, -POSE_SIZE:], gradient[-POSE_SIZE:]

    return jax.vmap(of_view)(table)


def pose_differences_px(
    problem: Problem,
) -> dict[int, tuple[np.ndarray, Float[np.ndarray, "_s 2"]]]:
    """For each camera but the first (shots, shifts in px of the middle of the board).

    A shift is the motion of the board's image in this camera were its pose free in this image, less
    the mean of the other cameras of the shot. It is small where they look at one moment.
    """
    if len(problem.state.set_from_board):
        return {}
    information, gradient = (
        np.asarray(part)[: len(problem.views)]
        for part in _by_view(problem.state, problem.chart, problem.table)
    )
    shifts: dict[int, dict[int, np.ndarray]] = {}
    for k, view in enumerate(problem.views):
        if view.used.any():
            shifts.setdefault(view.shot, {})[view.camera] = _image_shift_px(
                problem, k, information[k], gradient[k]
            )
    answer = {}
    for camera in range(1, problem.cameras):
        shots = sorted(shot for shot, own in shifts.items() if camera in own and len(own) > 1)
        if len(shots) >= _FEWEST_SHOTS:
            own = [
                shifts[shot][camera]
                - np.mean([each for c, each in shifts[shot].items() if c != camera], axis=0)
                for shot in shots
            ]
            answer[camera] = np.array(shots), np.array(own)
    return answer


def _image_shift_px(
    problem: Problem,
    k: int,
    information: Float[np.ndarray, "6 6"],
    gradient: Float[np.ndarray, "6"],
) -> Float[np.ndarray, "2"]:
    """Motion of the image of the board's middle by the step that fits image k alone."""
    view = problem.views[k]
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale) + 1e-9 * np.eye(POSE_SIZE)
    step = -scale * np.linalg.solve(scaled, gradient * scale)
    lens = lens_number(problem, int(problem.chart.lens_of_camera[view.camera]))
    cam_from_rig = Pose(np.asarray(problem.state.cam_from_rig)[view.camera])
    before = np.asarray(problem.state.rig_from_board)[view.shot]
    after = np.asarray(
        Pose(before).retract(step, PoseModel.RIGID, problem.chart.unit_mm).cam_from_world
    )
    places_mm = problem.target.centres_mm[view.detection.circle_index[view.used]]
    middle = np.append(places_mm.mean(axis=0), 0.0)[None]
    first, second = (
        project_points(cam_from_rig @ Pose(each), lens, middle)[0] for each in (before, after)
    )
    return second - first


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
