"""Public parameters of lenses and cameras in a world frame, with their covariance."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from trinoc.calib.problem.information import Information
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, RigState, retract
from trinoc.calib.targets.board_set import IN_SET_NAMES, board_prefixes
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit


class World(NamedTuple):
    """Reference frame of the result: the frame of the board in one shot, or the frame of one
    camera.

    Exactly one field is not None: the index of the shot or of the camera. It is an array, so that
    another index does not compile the program again.
    """

    shot: Int[np.ndarray, ""] | None
    camera: Int[np.ndarray, ""] | None


class NamedCovariance(NamedTuple):
    """Values and covariance of the public parameters of a rig, in degrees, mm and px.

    Attributes
    ----------
    names : "upper.pan_deg", ..., "upper.fx_px", ..., "board.scale_x", ... For a set of boards:
        "board.NAME.turn_x_deg", ..., and "board.NAME.scale_x", ...
    values : (p,) values of the parameters.
    covariance : (p, p) covariance of the parameters.
    """

    names: tuple[str, ...]
    values: Float[np.ndarray, "p"]
    covariance: Float[np.ndarray, "p p"]


def named_covariance(
    problem: Problem,
    information: Information,
    parameter_covariance: Float[np.ndarray, "f f"],
    variance_factor: float,
    cameras: tuple[str, ...],
    world: World,
) -> NamedCovariance:
    """Propagate the covariance of a fit to the public parameters, in degrees, mm and px.

    If the world is the board of a shot and all cameras look at its plane Z = 0, poses are given as
    pan, tilt, swing, distance and aim. Otherwise poses are rigid motions relative to the estimated
    ones.

    Parameters
    ----------
    problem : problem at its solution.
    information : information of the shots at the solution.
    parameter_covariance : (f, f) covariance of the estimated parameters of lenses, cameras and
        board shape. It contains `variance_factor`.
    variance_factor : factor by which the covariance of the board pose is multiplied.
    cameras : names of the cameras.
    world : reference frame of the poses.
    """
    _, over_sheet = poses_in_world(problem.state, world)
    is_over_sheet = world.shot is not None and np.isfinite(over_sheet).all()
    model = PoseModel.AIM_FREE if is_over_sheet else PoseModel.RIGID
    shot = 0 if world.shot is None else world.shot
    values, by_parameters, by_board = (
        np.asarray(part)
        for part in _parameters(problem.state, problem.parametrization, world, model=model)
    )
    by_board = by_board[:, shot] if world.shot is not None else np.zeros((len(values), POSE_SIZE))
    by_free = by_parameters[:, information.free]
    by_free = by_free + by_board @ information.board_by_parameters[shot][:, information.free]
    covariance = by_free @ parameter_covariance @ by_free.T
    covariance += variance_factor * by_board @ information.board_covariance[shot] @ by_board.T
    names = []
    for name in cameras:
        names += [f"{name}.{parameter}" for parameter in model.parameter_names]
        names += [f"{name}.{parameter}" for parameter in problem.state.lenses.parameter_names]
    prefixes = board_prefixes(problem.target)
    for prefix in prefixes[1:]:
        names += [f"{prefix}{parameter}" for parameter in IN_SET_NAMES]
    for prefix in prefixes:
        names += [f"{prefix}{parameter}" for parameter in problem.parametrization.sheet_model.names]
    return NamedCovariance(tuple(names), values, 0.5 * (covariance + covariance.T))


def _poses_in_world(state: RigState, world: World) -> Float[ArrayLike, "c 3 4"]:
    cameras = jnp.asarray(state.cam_from_rig)
    if world.shot is not None:
        rig_from_world = Pose(jnp.asarray(state.rig_from_board)[world.shot])
    else:
        rig_from_world = Pose(cameras[world.camera]).inverse
    return jax.vmap(lambda cam_from_rig: (Pose(cam_from_rig) @ rig_from_world).cam_from_world)(
        cameras
    )


@kept_jit
def poses_in_world(
    state: RigState, world: World
) -> tuple[Float[ArrayLike, "c 3 4"], Float[ArrayLike, "c 6"]]:
    """Poses cam_from_world of all c cameras, (c, 3, 4), and their parameters, (c, 6).

    The parameters are pan, tilt, swing (rad), distance and aim (mm); NaN for a camera that does not
    look at the sheet.
    """
    poses = _poses_in_world(state, world)
    return poses, jax.vmap(lambda pose: Pose(pose).parameters)(poses)


def undetermined_rows(
    problem: Problem, information: Information, names: tuple[str, ...], world: World
) -> np.ndarray:
    """Mask, (p,), of the public parameters that the observations do not determine.

    names : names of the p parameters. The pose of a camera that is itself the world is always
        determined.
    """
    parametrization, slices = problem.parametrization, problem.slices
    head_undetermined = np.zeros(len(parametrization.free), dtype=bool)
    head_undetermined[information.free[list(information.observability.gauge)]] = True
    count, size = parametrization.lens_shape
    lens_undetermined = head_undetermined[: count * size].reshape(count, 1, size)
    lens_rows = np.any((np.asarray(parametrization.lens_basis) != 0) & lens_undetermined, axis=2)
    poses_undetermined = bool(head_undetermined[slices.lenses.stop :].any())
    rows = []
    for camera, lens in enumerate(parametrization.lens_of_camera):
        is_world = world.camera is not None and int(world.camera) == camera
        rows += [not is_world and (poses_undetermined or bool(lens_rows.any()))] * POSE_SIZE
        rows += lens_rows[lens].tolist()
    rows += [poses_undetermined] * (POSE_SIZE * max(len(problem.state.set_from_board) - 1, 0))
    rows += head_undetermined[slices.sheets].tolist()
    assert len(rows) == len(names)
    return np.array(rows)


@partial(kept_jit, static_argnames=("model",))
def _parameters(
    state: RigState, parametrization: Parametrization, world: World, *, model: PoseModel
) -> tuple[Array, Array, Array]:
    """Values of the p public parameters, and their Jacobians.

    The first Jacobian, (p, h), is that with respect to the parameters that all shots share: lenses,
    cameras, board shape. The second, (p, s, 6), is that with respect to the board poses of the
    shots.
    """
    start = _poses_in_world(state, world)

    def values(head: Array, boards: Array) -> Array:
        moved = retract(state, parametrization, head, boards)
        poses = _poses_in_world(moved, world)

        def of_camera(pose: ArrayLike, origin: ArrayLike, lens: ArrayLike) -> Array:
            moved_lens = jax.tree.map(lambda leaf: leaf[lens], moved.lenses)
            numbers = Pose(pose).model_parameters(model, Pose(origin))
            in_degrees = jnp.concatenate([jnp.degrees(numbers[:3]), numbers[3:]])
            return jnp.concatenate([in_degrees, moved_lens.parameters])

        camera_values = jax.vmap(of_camera)(
            poses, start, jnp.asarray(parametrization.lens_of_camera)
        )
        # Rotations of boards are relative to their present pose; the reference board is fixed.
        turn_deg = jnp.degrees((head * parametrization.free)[parametrization.slices.boards])
        turn_deg = turn_deg.reshape(-1, POSE_SIZE)[1:, :3]
        set_values = jnp.concatenate([turn_deg, moved.set_from_board[1:, :, 3]], axis=1)
        return jnp.concatenate([camera_values.ravel(), set_values.ravel(), moved.sheet])

    head = jnp.zeros_like(jnp.asarray(parametrization.free))
    boards = jnp.zeros((state.rig_from_board.shape[0], POSE_SIZE), head.dtype)
    by_parameters, by_boards = jax.jacfwd(values, argnums=(0, 1))(head, boards)
    return values(head, boards), by_parameters, by_boards
