"""A rig to be fitted: its views, where the fit starts, and what of it is free."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.shots.motions import chained
from trinoc.calib.shots.state import POSE_SIZE, SHEET_SIZE, Chart, RigState
from trinoc.calib.shots.table import FEWEST_SHOTS, View, ViewTable, padded_count, view_table
from trinoc.calib.targets import AbstractTarget, boards_of
from trinoc.calib.uncertainty import Systematics
from trinoc.geometry import AFFINE_PARAMETERS, AbstractLens, stack_lenses

_SMALLEST_SIGMA = 1e-12


class Freedom(NamedTuple):
    """What is fitted of the lenses.

    Fields
    ------
    lens_of_camera : (c,) which lens each camera has.
    free : (l, q) which parameters of each lens are fitted.
    """

    lens_of_camera: np.ndarray
    free: Bool[np.ndarray, "l q"]


class Problem(NamedTuple):
    """Everything that the fit takes.

    Fields
    ------
    views : what was seen.
    target : the board.
    state : where the fit starts, or where it ended.
    chart : units, and what is free.
    shots : how many there are; arrays have more rows.
    sigma_factor : (c,) by how much the places' sigmas are multiplied for each camera.
    spent : how many numbers the residuals have told of where the board's places lie.
    spent_on_lenses : how many they have told of what has a prior in the lenses.
    """

    views: tuple[View, ...]
    target: AbstractTarget
    state: RigState
    chart: Chart
    shots: int
    sigma_factor: Float[np.ndarray, "c"]
    spent: float = 0.0
    spent_on_lenses: float = 0.0

    @property
    def cameras(self) -> int:
        """How many cameras there are."""
        return len(self.chart.lens_of_camera)

    @property
    def table(self) -> ViewTable:
        """The views as arrays."""
        table = view_table(self.views, self.target)
        by_view = self.sigma_factor[np.asarray(table.camera)]
        return table._replace(whitening=table.whitening / by_view[:, None, None, None])


class EndedProblem(NamedTuple):
    """Where a fit ended, and how well that is known.

    Fields
    ------
    problem : at its end.
    covariance : (f, f) of the free steps of the head.
    variance_factor : of the shots' noise, which is in the covariance.
    """

    problem: Problem
    covariance: Float[np.ndarray, "f f"]
    variance_factor: float


def problem_of(
    views: Sequence[View],
    target: AbstractTarget,
    lenses: Sequence[AbstractLens],
    cam_from_rig: Float[np.ndarray, "c 3 4"],
    rig_from_board: Float[np.ndarray, "s 3 4"],
    image_sizes_px: Sequence[tuple[int, int]],
    freedom: Freedom,
    systematics: Systematics,
    set_from_board: Float[np.ndarray, "b 3 4"] | None = None,
) -> Problem:
    """The problem at its start. The first camera, and of several boards the first, stay in place.

    image_sizes_px : (width, height) of the pictures of each lens. set_from_board : of each of
    several boards.
    """
    members = boards_of(target)
    in_set = np.zeros((0, 3, 4))
    if len(members) > 1 and set_from_board is not None:
        in_set = np.asarray(set_from_board)
    shots = len(rig_from_board)
    more = padded_count(shots, FEWEST_SHOTS) - shots
    boards = np.concatenate([rig_from_board, np.broadcast_to(np.eye(3, 4), (more, 3, 4))])
    stacked = stack_lenses([_plain(lens) for lens in lenses])
    scale = np.stack(
        [lens.parameter_scales(size) for lens, size in zip(lenses, image_sizes_px, strict=True)]
    )
    state = RigState(
        stacked,
        np.asarray(cam_from_rig),
        boards,
        in_set,
        np.zeros(SHEET_SIZE * len(members)),
        np.zeros((0, 3)),
    )
    depths = [np.linalg.norm(cam_from_board(state, view)[:, 3]) for view in views]
    information, sheet_free = _sheet_prior(systematics, len(members))
    pose_free, set_free = np.ones((len(cam_from_rig), POSE_SIZE)), np.ones((len(in_set), POSE_SIZE))
    pose_free[0] = 0.0
    set_free[:1] = 0.0
    free = (freedom.free, pose_free, set_free, sheet_free)
    chart = Chart(
        lens_scale=scale,
        unit_mm=np.asarray(float(np.median(depths))),
        half_mm=np.stack([np.abs(board.centres_mm).max(axis=0) for board in members]),
        lens_of_camera=np.asarray(freedom.lens_of_camera),
        free=np.concatenate([part.astype(float).ravel() for part in free]),
        lens_information=np.zeros((*scale.shape, scale.shape[1])),
        sheet_information=information,
        shape_information=np.ones(3),
        has_circles=bool(np.any(target.radius_mm > 0)),
    )
    factor = np.ones(len(cam_from_rig))
    problem = Problem(tuple(views), target, state, chart, shots, factor)
    return with_lens_free(problem, freedom.free)


def with_lens_free(problem: Problem, free: Bool[np.ndarray, "l q"]) -> Problem:
    """The problem with other parameters of the lenses held; held coefficients are zero, but for
    lenses that are held as a whole, and for what is never fitted."""
    lenses, size = problem.chart.lens_scale.shape
    head = np.array(problem.chart.free)
    head[: lenses * size] = free.astype(float).ravel()
    given = np.asarray(problem.state.lenses.coefficients)
    whole = ~free.any(axis=1, keepdims=True)
    model = problem.state.lenses
    never = np.array([[name in model.never_fitted for name in model.coefficient_names]], dtype=bool)
    kept = np.where(free[:, len(AFFINE_PARAMETERS) :] | whole | never, given, 0.0)
    state = eqx.tree_at(lambda state: state.lenses.coefficients, problem.state, kept)
    return problem._replace(chart=_with_free(problem.chart, head), state=state)


def with_wider_lenses(
    problem: Problem, lenses: Sequence[AbstractLens], image_sizes_px: Sequence[tuple[int, int]]
) -> Problem:
    """The problem with lenses of a model whose parameters begin with those of its own.

    What is added is free, without a prior, of lenses that are not held as a whole.
    """
    count, size = problem.chart.lens_scale.shape
    names, never = lenses[0].parameter_names[size:], lenses[0].never_fitted
    scale = np.stack(
        [lens.parameter_scales(each) for lens, each in zip(lenses, image_sizes_px[:count])]
    )
    head = np.asarray(problem.chart.free)
    of_lens, of_rest = head[: count * size].reshape(count, size), head[count * size :]
    added = of_lens.any(axis=1, keepdims=True) * np.array([name not in never for name in names])
    chart = eqx.tree_at(
        lambda chart: (chart.lens_scale, chart.free, chart.lens_information),
        problem.chart,
        (
            scale,
            np.append(np.append(of_lens, added, axis=1).ravel(), of_rest),
            np.zeros((*scale.shape, scale.shape[1])),
        ),
    )
    state = eqx.tree_at(
        lambda state: state.lenses, problem.state, stack_lenses([_plain(lens) for lens in lenses])
    )
    return problem._replace(state=state, chart=chart)


def with_sheet_held(problem: Problem) -> Problem:
    """The problem with the board taken as it was found."""
    head = np.array(problem.chart.free)
    head[problem.chart.sheet_first :] = 0.0
    return problem._replace(chart=_with_free(problem.chart, head))


def with_head_held(problem: Problem) -> Problem:
    """The problem with lenses, cameras and board as they are: only where it stands is free."""
    return problem._replace(chart=_with_free(problem.chart, np.zeros(len(problem.chart.free))))


def cam_from_board(state: RigState, view: View) -> Float[np.ndarray, "3 4"]:
    """The pose of a view's board before its camera."""
    pose = chained(
        np.asarray(state.cam_from_rig)[view.camera], np.asarray(state.rig_from_board)[view.shot]
    )
    if not len(state.set_from_board):
        return pose
    return chained(pose, np.asarray(state.set_from_board)[view.board])


def lens_number(problem: Problem, number: int) -> AbstractLens:
    """One of the stacked lenses of the state."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[number], problem.state.lenses)


def _with_free(chart: Chart, free: Float[np.ndarray, "h"]) -> Chart:
    return eqx.tree_at(lambda chart: chart.free, chart, free)


def _sheet_prior(
    systematics: Systematics, boards: int
) -> tuple[Float[np.ndarray, "w w"], Float[np.ndarray, "w"]]:
    """Information on scales and warps, and which of these are free: those that are not exact.

    The size is off alike for all boards of a set, as one printer makes it; scales along X and Y,
    and warps, are each board's own.
    """
    size = np.zeros((SHEET_SIZE, SHEET_SIZE))
    size[:2, :2] = systematics.print_size_sigma**2
    own = np.diag([*np.square(systematics.print_scale_sigma), 0.0, 0.0])
    own += np.diag([0.0, 0.0, systematics.flatness_mm**2, systematics.flatness_mm**2])
    covariance = np.kron(np.ones((boards, boards)), size) + np.kron(np.eye(boards), own)
    free = (np.diag(covariance) > _SMALLEST_SIGMA**2).astype(float)
    # A size that is off with sides in proportion is one unknown, not two.
    covariance += np.diag(np.where(free > 0, 1e-6 * np.diag(covariance), 0.0))
    rows = np.flatnonzero(free)
    information = np.zeros_like(covariance)
    information[np.ix_(rows, rows)] = np.linalg.inv(covariance[np.ix_(rows, rows)])
    return information, free


def _plain(lens: AbstractLens) -> AbstractLens:
    return type(lens)(
        *(
            np.asarray(part, dtype=np.float64)
            for part in (
                lens.focal_length_px,
                lens.principal_point_px,
                lens.skew_px,
                lens.coefficients,
            )
        )
    )
