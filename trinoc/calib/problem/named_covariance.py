"""Lenses and cameras as named parameters in a world, with their covariance."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.calib.problem.information import Information
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.variables import POSE_SIZE, RigState, retract
from trinoc.calib.targets import board_prefixes
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import ArrayLike

# Of a board fixed to others: its turn about the axes of their frame from where it stands, and where
# its origin lies there.
IN_SET_NAMES = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


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
        names += [f"{prefix}{each}" for each in problem.chart.sheet_model.names]
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
        here = retract(state, chart, head, boards)
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
