"""What the shots determine of lenses and cameras, as named parameters with their covariance."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.shots.normal_equations import view_blocks
from trinoc.calib.shots.problem import Problem
from trinoc.calib.shots.state import (
    IN_SET_NAMES,
    POSE_SIZE,
    SHEET_NAMES,
    Chart,
    RigState,
    retracted,
)
from trinoc.calib.shots.table import ViewTable
from trinoc.calib.targets import board_prefixes
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import (
    ArrayLike,
    GemanMcClure,
    Observability,
    inverse_positive_definite,
    observability,
)


class Information(NamedTuple):
    """What each shot says of the head, its board eliminated, at the end of a fit.

    Fields
    ------
    of_shot : (s, h, h) information of each shot, without what was known beforehand.
    pulls : (s, h) gradient of half of each shot's chi-square; with the prior's they cancel.
    follow : (s, 6, h) how each board follows the head.
    own : (s, 6, 6) covariance of each board, the head given.
    free : (f,) columns of the head that were fitted.
    prior : (f, f) information that was known of lenses and board beforehand.
    shape_first : where, in the head, the steps of the board's places begin.
    """

    of_shot: Float[np.ndarray, "s h h"]
    pulls: Float[np.ndarray, "s h"]
    follow: Float[np.ndarray, "s 6 h"]
    own: Float[np.ndarray, "s 6 6"]
    free: np.ndarray
    prior: Float[np.ndarray, "f f"]
    shape_first: int

    @property
    def seen(self) -> Observability:
        """What is determined of the free steps of the head."""
        return self.seen_of(np.ones(len(self.free), dtype=bool))

    def seen_of(self, rows: Bool[np.ndarray, "f"]) -> Observability:
        """What is determined of some of the free steps, the others held."""
        free = self.free[rows]
        kept = self.of_shot.sum(axis=0)[np.ix_(free, free)] + self.prior[np.ix_(rows, rows)]
        count = len(free)
        return observability(0.5 * (kept + kept.T), np.eye(count), np.full(count, np.inf))


def information_of(problem: Problem) -> Information:
    """The information at a problem's state."""
    of_shot, pulls, follow, own = (
        np.asarray(part) for part in _of_shots(problem.state, problem.chart, problem.table)
    )
    free = np.flatnonzero(problem.chart.free)
    prior = np.zeros((len(problem.chart.free),) * 2)
    first, lenses = problem.chart.sheet_first, problem.chart.lens_scale.size
    prior[:lenses, :lenses] = np.asarray(problem.chart.lens_prior)
    prior[first:, first:] = np.asarray(problem.chart.board_prior)
    prior = prior[np.ix_(free, free)]
    return Information(of_shot, pulls, follow, own, free, prior, problem.chart.shape_first)


@eqx.filter_jit
def _of_shots(state: RigState, chart: Chart, table: ViewTable) -> tuple[Array, ...]:
    plain = GemanMcClure.from_scale(jnp.asarray(jnp.inf))
    columns, own, gradient = jax.vmap(lambda *view: view_blocks(state, chart, plain, *view))(*table)
    size, shots, heads = columns.shape[1], state.rig_from_board.shape[0], chart.free.shape[0]
    shot = jnp.asarray(table.shot)
    head = jnp.zeros((shots, heads, heads), own.dtype)
    head = head.at[shot[:, None, None], columns[:, :, None], columns[:, None, :]].add(
        own[:, :size, :size]
    )
    coupling = jnp.zeros((shots, heads, POSE_SIZE), own.dtype)
    coupling = coupling.at[shot[:, None], columns].add(own[:, :size, size:])
    block = jnp.zeros((shots, POSE_SIZE, POSE_SIZE), own.dtype).at[shot].add(own[:, size:, size:])
    of_head = jnp.zeros((shots, heads), own.dtype)
    of_head = of_head.at[shot[:, None], columns].add(gradient[:, :size])
    of_board = jnp.zeros((shots, POSE_SIZE), own.dtype).at[shot].add(gradient[:, size:])
    inverse = jax.vmap(inverse_positive_definite)(block)
    determined = jnp.all(jnp.isfinite(inverse), axis=(1, 2))
    inverse = jnp.where(determined[:, None, None], inverse, 0.0)
    follow = -jnp.einsum("spq,shq->sph", inverse, coupling)
    return (
        head + jnp.einsum("shp,spg->shg", coupling, follow),
        of_head + jnp.einsum("sph,sp->sh", follow, of_board),
        follow,
        inverse,
    )


class World(NamedTuple):
    """Where the world lies: the board in a shot, or a camera; one of them is given."""

    shot: int | np.ndarray | None
    camera: int | np.ndarray | None


class NamedCovariance(NamedTuple):
    """Parameters of a rig in a world, in degrees, mm and px.

    Fields
    ------
    names : "upper.pan_deg", ..., "upper.fx_px", ..., "board.scale_x", ...; of several boards
        "board.NAME.turn_x_deg", ..., and "board.NAME.scale_x", ...
    values : (p,).
    covariance : (p, p).
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]


def named_covariance(
    problem: Problem,
    information: Information,
    head_covariance: Float[np.ndarray, "f f"],
    variance_factor: float,
    cameras: tuple[str, ...],
    world: World,
) -> NamedCovariance:
    """The public parameters, with the covariance that the head's and the world's board's have.

    variance_factor : of the board's own covariance; the head's already has it.

    Poses are pan, tilt, swing, distance and aim where all cameras look at the plane Z = 0, rigid
    motions about where they stand otherwise.
    """
    model = _pose_model(problem, world)
    shot = 0 if world.shot is None else world.shot
    values, by_head, by_board = (
        np.asarray(part)
        for part in _parameters(
            problem.state, problem.chart, World(*(_index(k) for k in world)), model
        )
    )
    by_board = by_board[:, shot] if world.shot is not None else np.zeros((len(values), POSE_SIZE))
    by_free = by_head[:, information.free]
    by_free = by_free + by_board @ information.follow[shot][:, information.free]
    covariance = by_free @ head_covariance @ by_free.T
    covariance += variance_factor * by_board @ information.own[shot] @ by_board.T
    names = []
    for name in cameras:
        names += [f"{name}.{each}" for each in model.parameter_names]
        names += [f"{name}.{each}" for each in problem.state.lenses.parameter_names]
    prefixes = board_prefixes(problem.target)
    for prefix in prefixes[1:]:
        names += [f"{prefix}{each}" for each in IN_SET_NAMES]
    for prefix in prefixes:
        names += [f"{prefix}{each}" for each in SHEET_NAMES]
    return NamedCovariance(tuple(names), values, 0.5 * (covariance + covariance.T))


def cam_from_world(state: RigState, world: World) -> Float[ArrayLike, "c 3 4"]:
    """Pose of every camera in the world."""
    if world.shot is not None:
        base = jnp.asarray(state.rig_from_board)[world.shot]
    else:
        own = jnp.asarray(state.cam_from_rig)[world.camera]
        turn = own[:, :3].T
        base = jnp.concatenate([turn, -(turn @ own[:, 3])[:, None]], axis=1)

    def pose(own: Float[Array, "3 4"]) -> Float[Array, "3 4"]:
        translation = own[:, :3] @ base[:, 3] + own[:, 3]
        return jnp.concatenate([own[:, :3] @ base[:, :3], translation[:, None]], axis=1)

    return jax.vmap(pose)(jnp.asarray(state.cam_from_rig))


def _index(number: int | np.ndarray | None) -> np.ndarray | None:
    """A number as an array, so that another one does not compile anew."""
    return None if number is None else np.asarray(number)


def _pose_model(problem: Problem, world: World) -> PoseModel:
    poses = np.asarray(cam_from_world(problem.state, world))
    if world.shot is None:
        return PoseModel.RIGID
    values = [np.asarray(Pose(jnp.asarray(pose)).parameters) for pose in poses]
    return PoseModel.AIM_FREE if np.isfinite(values).all() else PoseModel.RIGID


@eqx.filter_jit
def _parameters(
    state: RigState, chart, world: World, model: PoseModel
) -> tuple[Array, Array, Array]:
    """Values of all named parameters, and their derivatives by a step of head and boards."""
    start = cam_from_world(state, world)

    def values(head: Array, boards: Array) -> Array:
        here = retracted(state, chart, head, boards)
        poses = cam_from_world(here, world)

        def of_camera(pose: ArrayLike, origin: ArrayLike, lens: ArrayLike) -> Array:
            own = jax.tree.map(lambda leaf: leaf[lens], here.lenses)
            numbers = Pose(pose).model_parameters(model, Pose(origin))
            in_degrees = jnp.concatenate([jnp.degrees(numbers[:3]), numbers[3:]])
            return jnp.concatenate([in_degrees, own.parameters])

        every = jax.vmap(of_camera)(poses, start, jnp.asarray(chart.lens_of_camera))
        # How far a board turns is told from where it stands; its reference does not move.
        turn_deg = jnp.degrees((head * chart.free)[chart.boards_first : chart.sheet_first])
        turn_deg = turn_deg.reshape(-1, POSE_SIZE)[1:, :3]
        in_set = jnp.concatenate([turn_deg, here.set_from_board[1:, :, 3]], axis=1)
        return jnp.concatenate([every.ravel(), in_set.ravel(), here.sheet])

    head = jnp.zeros_like(jnp.asarray(chart.free))
    boards = jnp.zeros((state.rig_from_board.shape[0], POSE_SIZE), head.dtype)
    by_head, by_boards = jax.jacfwd(values, argnums=(0, 1))(head, boards)
    return values(head, boards), by_head, by_boards
