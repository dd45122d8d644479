"""Do two halves of the shots agree as well as their covariances claim?"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.information import information_of
from trinoc.calib.problem.problem import Problem, lens_number, with_sheet_held
from trinoc.calib.problem.robust_fit import fitted
from trinoc.calib.problem.shot_scatter import with_factor
from trinoc.calib.shots.cross_validation import FEWEST_SHOTS, of_shots, shots_of
from trinoc.calib.shots.field_difference import FieldDifference, field_differences
from trinoc.calib.targets import board_prefixes

# Of the largest variance: below, a prior that both halves share has left no difference.
_LEAST_SHARE = 1e-10


class HalvesCheck(NamedTuple):
    """The rig from one half of the shots against that from the other.

    Fields
    ------
    ratio : difference over claimed sigma, root mean square over everything determined: 1 where
        the model is right, more where something is not in it.
    worst : name of the parameter with the largest difference in sigmas, as "camera 1" has them.
    worst_ratio : that difference.
    parameters : how many were compared.
    over_field : for each camera how far apart both image the same points, in px and beside what
        is claimed.
    """

    ratio: float
    worst: str
    worst_ratio: float
    parameters: int
    over_field: tuple[FieldDifference, ...] = ()


def halves_check(
    problem: Problem, cameras: tuple[str, ...], variance_factor: float
) -> HalvesCheck | None:
    """Compare every second shot with the others; None where a half does not determine the rig.

    The board is taken as the whole fit found it, since both halves share it; `variance_factor` is
    that by which its covariance was enlarged.
    """
    shots = shots_of(problem)
    if len(shots) < FEWEST_SHOTS:
        return None
    problem = with_sheet_held(problem)
    ends, states = [], []
    for remainder in (0, 1):
        end, converged = fitted(of_shots(problem, shots[remainder::2]))
        information = information_of(end)
        seen = information.seen
        if not converged or seen.rank < len(information.free):
            return None
        prior = information.prior
        ends.append((steps_between(problem, end)[information.free], seen.covariance))
        states.append(end.state)
    (first, first_covariance), (second, second_covariance) = ends
    covariance = covariance_of_difference(
        first_covariance, second_covariance, prior, variance_factor
    )
    difference = first - second
    sigma = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    told, square = _squared(difference, covariance)
    ratio = float(np.sqrt(square / told))
    each = np.abs(difference) / sigma
    worst = int(np.argmax(each))
    names = head_names(problem, cameras)
    column = int(np.flatnonzero(problem.chart.free)[worst])
    over_field = field_differences(problem, states, covariance, cameras)
    return HalvesCheck(ratio, names[column], float(each[worst]), told, over_field)


def covariance_of_difference(
    first: Float[np.ndarray, "f f"],
    second: Float[np.ndarray, "f f"],
    prior: Float[np.ndarray, "f f"],
    variance_factor: float,
) -> Float[np.ndarray, "f f"]:
    """Of two fits to other data, of these covariances, that one prior of information P draws both.

    Each has noise of its own, of covariance f C_i (P^-1 - C_i) P; the prior's error, which both
    have in the shares C_i P, is left in (C_1 - C_2) P (C_1 - C_2).
    """
    shared = first @ prior @ second
    own = [with_factor(each, variance_factor, prior) for each in (first, second)]
    return own[0] + own[1] - shared - shared.T


def _squared(
    difference: Float[np.ndarray, "f"], covariance: Float[np.ndarray, "f f"]
) -> tuple[int, float]:
    """In how many directions the halves can differ at all, and by how many squared sigmas."""
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    can = values > _LEAST_SHARE * values[-1]
    along = vectors[:, can].T @ (difference / scale)
    return int(can.sum()), float(np.sum(along**2 / values[can]))


def steps_between(problem: Problem, end: Problem) -> np.ndarray:
    """The step of the head that takes the whole fit to that of a half."""
    start, stop, chart = problem.state, end.state, problem.chart
    count, _ = chart.lens_shape
    lenses = [
        np.asarray(lens_number(end, k).parameters) - np.asarray(lens_number(problem, k).parameters)
        for k in range(count)
    ]
    by_lens = np.stack(lenses) / np.asarray(chart.lens_scale)
    poses, pairs = [], [*zip(stop.cam_from_rig, start.cam_from_rig, strict=True)]
    pairs += zip(stop.set_from_board, start.set_from_board, strict=True)
    for after, before in pairs:
        turn = np.asarray(after)[:, :3] @ np.asarray(before)[:, :3].T
        skew = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0],
                               turn[1, 0] - turn[0, 1]])  # fmt: skip
        ends = [
            -np.asarray(motion)[:, :3].T @ np.asarray(motion)[:, 3] for motion in (after, before)
        ]
        shift = (ends[0] - ends[1]) / float(chart.unit_mm)
        poses.append(np.concatenate([skew, shift]))
    return np.concatenate(
        [by_lens.ravel(), np.ravel(poses), np.zeros(len(chart.free) - chart.sheet_first)]
    )


def head_names(problem: Problem, cameras: tuple[str, ...]) -> list[str]:
    """Names of the steps of the head, the places of the board left out."""
    of_lens = problem.state.lenses.parameter_names
    owner = [
        cameras[int(np.flatnonzero(problem.chart.lens_of_camera == k)[0])]
        for k in range(problem.chart.lens_shape[0])
    ]
    pose = ("turn_x", "turn_y", "turn_z", "x", "y", "z")
    names = [f"{name}.{each}" for name in owner for each in of_lens]
    names += [f"{name}.{each}" for name in cameras for each in pose]
    prefixes = board_prefixes(problem.target)
    if len(problem.state.set_from_board):
        names += [f"{prefix}{each}" for prefix in prefixes for each in pose]
    sheet = [name.removesuffix("_mm") for name in problem.chart.sheet_model.names]
    return [*names, *(f"{prefix}{each}" for prefix in prefixes for each in sheet)]
