"""The unknowns of a rig of many shots, and the small steps that change them.

The frame of the rig is that of its first camera while it is fitted; where the world lies is
chosen at the end.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.linalg import block_diag
from jaxtyping import Float, Int

from trinoc.geometry import AbstractLens, rotation_from_vector
from trinoc.numerics import ArrayLike

# Scale along X and along Y, and the rise of the middle of the board over its edges along both.
SHEET_NAMES = ("scale_x", "scale_y", "warp_x_mm", "warp_y_mm")
SHEET_SIZE, POSE_SIZE = len(SHEET_NAMES), 6
# Of a board fixed to others: its turn about the axes of their frame from where it stands, and where
# its origin lies there.
IN_SET_NAMES = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


class RigState(eqx.Module):
    """Lenses, cameras, boards of all shots, and how the board was made.

    Fields
    ------
    lenses : l lenses of one model, along the first axis of their fields.
    cam_from_rig : (c, 3, 4) of each camera.
    rig_from_board : (s, 3, 4) of the board in each shot; of a set of boards, of their common frame.
    set_from_board : (b, 3, 4) of each of several boards; no rows for one board, whose frame is it.
    sheet : (4 b,) `SHEET_NAMES` of each board: scales over nominal less one, and warps in mm.
    shape : (p, 3) by which each place of the board lies elsewhere, X, Y and Z in mm; no rows where
        all lie where the drawing and `sheet` have them.
    """

    lenses: AbstractLens
    cam_from_rig: Float[ArrayLike, "c 3 4"]
    rig_from_board: Float[ArrayLike, "s 3 4"]
    set_from_board: Float[ArrayLike, "_b 3 4"]
    sheet: Float[ArrayLike, "w"]
    shape: Float[ArrayLike, "p 3"]


class Chart(eqx.Module):
    """Units of all steps, and which are taken.

    Fields
    ------
    lens_scale : (l, q) change of each lens's parameters for a step of one.
    unit_mm : length of a step of one in translations.
    half_mm : (b, 2) half the extent of each board, where its warp is zero.
    lens_of_camera : (c,) which of the lenses each camera has.
    free : (h,) 1 for steps of the head that are taken, 0 for others.
    lens_information : (l, q, q) inverse covariance of the prior on each lens's parameters, whose
        mean is 0; zero where nothing was known.
    sheet_information : (4 b, 4 b) inverse covariance of the prior on `sheet`, whose mean is 0.
    shape_information : (3,) inverse variance of the prior on each axis of `shape`.
    has_circles : whether some place is a circle.
    """

    lens_scale: Float[ArrayLike, "l q"]
    unit_mm: Float[ArrayLike, ""]
    half_mm: Float[ArrayLike, "b 2"]
    lens_of_camera: Int[ArrayLike, "c"]
    free: Float[ArrayLike, "h"]
    lens_information: Float[ArrayLike, "l q q"]
    sheet_information: Float[ArrayLike, "w w"]
    shape_information: Float[ArrayLike, "3"]
    has_circles: bool = eqx.field(static=True)

    @property
    def sheet_scale(self) -> Float[ArrayLike, "w"]:
        """Change of `sheet` for a step of one."""
        own = jnp.stack([jnp.ones_like(self.unit_mm)] * 2 + [jnp.asarray(self.unit_mm)] * 2)
        return jnp.tile(own, self.half_mm.shape[0])

    @property
    def boards_first(self) -> int:
        """Where, in the head, the steps of several boards' poses in their set begin."""
        return self.lens_scale.size + POSE_SIZE * self.lens_of_camera.shape[0]

    @property
    def sheet_first(self) -> int:
        """Where, in the head, the steps of the sheets begin; those of their places follow."""
        boards = self.half_mm.shape[0]
        return self.boards_first + (POSE_SIZE * boards if boards > 1 else 0)

    @property
    def shape_first(self) -> int:
        """Where, in the head, the steps of the boards' places begin."""
        return self.sheet_first + SHEET_SIZE * self.half_mm.shape[0]

    @property
    def lens_prior(self) -> Float[ArrayLike, "k k"]:
        """Information known beforehand on the steps of all lenses, which begin the head."""
        of_each = self.lens_scale[:, :, None] * self.lens_information * self.lens_scale[:, None, :]
        return block_diag(*of_each)

    @property
    def board_prior(self) -> Float[ArrayLike, "b b"]:
        """Information that was known beforehand on the steps of sheet and places."""
        scale = self.sheet_scale
        sheet = scale[:, None] * self.sheet_information * scale[None, :]
        places = (self.free.shape[0] - self.shape_first) // 3
        of_shape = jnp.tile(self.unit_mm**2 * self.shape_information, places)
        return block_diag(sheet, jnp.diag(of_shape))


def head_columns(
    chart: Chart, camera: Int[ArrayLike, ""], board: Int[ArrayLike, ""]
) -> Int[ArrayLike, "k"]:
    """Where, in the head, the steps of one camera's lens, its pose, that of one of several boards,
    this board's sheet and all places stand."""
    lenses, size = chart.lens_scale.shape
    lens = chart.lens_of_camera[camera] * size + jnp.arange(size)
    pose = lenses * size + camera * POSE_SIZE + jnp.arange(POSE_SIZE)
    sheet = chart.sheet_first + board * SHEET_SIZE + jnp.arange(SHEET_SIZE)
    places = jnp.arange(chart.shape_first, chart.free.shape[0])
    if chart.sheet_first == chart.boards_first:
        return jnp.concatenate([lens, pose, sheet, places])
    in_set = chart.boards_first + board * POSE_SIZE + jnp.arange(POSE_SIZE)
    return jnp.concatenate([lens, pose, in_set, sheet, places])


def moved(
    transform: Float[ArrayLike, "3 4"],
    step: Float[ArrayLike, "6"],
    unit_mm: Float[ArrayLike, ""],
) -> Float[ArrayLike, "3 4"]:
    """A rigid motion after a rotation vector and a translation in units of `unit_mm`."""
    rotation = rotation_from_vector(step[:3]) @ transform[:, :3]
    translation = transform[:, 3] + unit_mm * step[3:]
    return jnp.concatenate([rotation, translation[:, None]], axis=1)


def retracted(
    state: RigState,
    chart: Chart,
    head: Float[ArrayLike, "h"],
    boards: Float[ArrayLike, "s 6"],
) -> RigState:
    """The state after a step."""
    lenses, size = chart.lens_scale.shape
    cameras = state.cam_from_rig.shape[0]
    head = head * chart.free
    by_lens = head[: lenses * size].reshape(lenses, size)
    by_camera = head[lenses * size : chart.boards_first].reshape(cameras, -1)
    by_board = head[chart.boards_first : chart.sheet_first].reshape(-1, POSE_SIZE)
    by_sheet, by_shape = jnp.split(
        head[chart.sheet_first :], [chart.shape_first - chart.sheet_first]
    )
    step_all = jax.vmap(moved, (0, 0, None))
    return RigState(
        jax.vmap(lambda lens, step: lens.retract(step))(state.lenses, chart.lens_scale * by_lens),
        step_all(state.cam_from_rig, by_camera, chart.unit_mm),
        step_all(state.rig_from_board, boards, chart.unit_mm),
        step_all(state.set_from_board, by_board, chart.unit_mm),
        state.sheet + chart.sheet_scale * by_sheet,
        state.shape + chart.unit_mm * by_shape.reshape(-1, 3),
    )
