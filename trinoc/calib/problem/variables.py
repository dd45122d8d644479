"""The unknowns of a calibration, and the small steps that change them.

Some cameras look at a board in some shots. What all shots share is the *head*: lenses, cameras,
where several boards stand in their set, how each board was printed and bent, and where single
places of it lie. Each shot has a *block*: where the board stands in it. A problem says which of
these are free (`Parametrization.free`) and what was known of them beforehand.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.linalg import block_diag
from jaxtyping import Array, Float, Int

from trinoc.calib.problem.sheet import AbstractSheet
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.pose import Pose, PoseModel
from trinoc.numerics.precision import ArrayLike

POSE_SIZE = PoseModel.RIGID.size
# numerical: rows of a pose.
_AIM_STEPS = np.eye(POSE_SIZE)[4:]


class RigState(eqx.Module):
    """Lenses, cameras, boards of all shots, and how the board was made.

    Fields
    ------
    lenses : l lenses of one model, along the first axis of their fields.
    cam_from_rig : (c, 3, 4) of each camera.
    rig_from_board : (s, 3, 4) of the board in each shot; of a set of boards, of their common frame.
    set_from_board : (b, 3, 4) of each of several boards; no rows for one board, whose frame is it.
    sheet : (b * w,) numbers of each board's `AbstractSheet`.
    shape : (p, 3) by which each place of the board lies elsewhere, X, Y and Z in mm; no rows where
        all lie where the drawing and `sheet` have them.
    """

    lenses: AbstractLens
    cam_from_rig: Float[ArrayLike, "c 3 4"]
    rig_from_board: Float[ArrayLike, "s 3 4"]
    set_from_board: Float[ArrayLike, "_b 3 4"]
    sheet: Float[ArrayLike, "w"]
    shape: Float[ArrayLike, "p 3"]


class Priors(eqx.Module):
    """Normal laws of what was known of the unknowns beforehand.

    Fields
    ------
    lens_mean : (l, q) parameters of each lens that were thought likeliest.
    lens_information : (l, q, q) inverse covariance of these; zero where nothing was known.
    sheet_information : (w, w) inverse covariance of `RigState.sheet`, whose mean is 0.
    shape_information : (3p, 3p) inverse covariance of `RigState.shape`, whose mean is 0; no rows
        where that has none.
    aim_information : (c,) inverse variance, in 1/mm^2, of each coordinate of the point of Z = 0 on
        each optical axis, whose mean is the origin.
    """

    lens_mean: Float[ArrayLike, "l q"]
    lens_information: Float[ArrayLike, "l q q"]
    sheet_information: Float[ArrayLike, "w w"]
    shape_information: Float[ArrayLike, "m m"]
    aim_information: Float[ArrayLike, "c"]


class HeadSlices(NamedTuple):
    """Where, in the head, the steps of each kind of unknown stand, in the order of the head.

    Fields
    ------
    lenses : each has `lens_size` steps.
    cameras : POSE_SIZE steps of each camera's pose.
    boards : POSE_SIZE steps of the pose, in their set, of each of several boards; none of one.
    sheets : of how each board is bent and stretched.
    places : 3 steps of each place of the boards.
    lens_size : steps of one lens.
    """

    lenses: slice
    cameras: slice
    boards: slice
    sheets: slice
    places: slice
    lens_size: int

    def lens(self, number: int) -> slice:
        """The steps of one lens."""
        return _part(self.lenses, number, self.lens_size)

    def camera(self, number: int) -> slice:
        """The steps of one camera's pose."""
        return _part(self.cameras, number, POSE_SIZE)


def _part(whole: slice, number: int, size: int) -> slice:
    first = whole.start + number * size
    return slice(first, first + size)


class Parametrization(eqx.Module):
    """What a step changes, by how much, and which steps are taken.

    Fields
    ------
    lens_basis : (l, q, r) change of each lens's q parameters by its r steps: units on a diagonal,
        or the factor of a covariance, whose steps are in standard deviations.
    unit_mm : length of a step of one in translations.
    sheet_model : how a board is bent and stretched.
    sheet_scale : (w,) change of `RigState.sheet` for a step of one.
    lens_of_camera : (c,) which of the lenses each camera has.
    free : (h,) 1 for steps of the head that are taken, 0 for others.
    boards_free : 1 where the boards of the shots move, 0 where they stay.
    priors : what was known beforehand.
    pose_model : of the steps of cameras: RIGID, or AIM_FREE over a sheet that stays.
    has_circles : whether some place is a circle.
    """

    lens_basis: Float[ArrayLike, "l q r"]
    unit_mm: Float[ArrayLike, ""]
    sheet_model: AbstractSheet
    sheet_scale: Float[ArrayLike, "w"]
    lens_of_camera: Int[ArrayLike, "c"]
    free: Float[ArrayLike, "h"]
    boards_free: Float[ArrayLike, ""]
    priors: Priors
    pose_model: PoseModel = eqx.field(static=True)
    has_circles: bool = eqx.field(static=True)

    @property
    def lens_shape(self) -> tuple[int, int]:
        """How many lenses there are, and how many steps each has."""
        lenses, _, steps = self.lens_basis.shape
        return lenses, steps

    @property
    def lens_scale(self) -> Float[ArrayLike, "l q"]:
        """Change of each parameter for a step of one, where each parameter has its own step."""
        return self.lens_basis.diagonal(axis1=1, axis2=2)

    @property
    def boards(self) -> int:
        """How many boards there are."""
        return self.sheet_scale.shape[0] // len(self.sheet_model.names)

    @property
    def slices(self) -> HeadSlices:
        """Where the steps of each kind stand in the head."""
        lenses, lens_size = self.lens_shape
        sizes = (
            lenses * lens_size,
            POSE_SIZE * self.lens_of_camera.shape[0],
            POSE_SIZE * self.boards if self.boards > 1 else 0,
            self.sheet_scale.shape[0],
        )
        cameras, boards, sheets, places = itertools.accumulate(sizes)
        return HeadSlices(
            lenses=slice(0, cameras),
            cameras=slice(cameras, boards),
            boards=slice(boards, sheets),
            sheets=slice(sheets, places),
            places=slice(places, self.free.shape[0]),
            lens_size=lens_size,
        )


def head_columns(
    parametrization: Parametrization, camera: Int[ArrayLike, ""], board: Int[ArrayLike, ""]
) -> Int[Array, "k"]:
    """Where, in the head, the steps of one camera's lens, its pose, that of one of several boards,
    this board's sheet and all places stand."""
    slices, terms = parametrization.slices, len(parametrization.sheet_model.names)
    size = slices.lens_size
    lens = parametrization.lens_of_camera[camera] * size + jnp.arange(size)
    pose = slices.cameras.start + camera * POSE_SIZE + jnp.arange(POSE_SIZE)
    in_set = jnp.zeros(0, int)
    if parametrization.boards > 1:
        in_set = slices.boards.start + board * POSE_SIZE + jnp.arange(POSE_SIZE)
    sheet = slices.sheets.start + board * terms + jnp.arange(terms)
    places = jnp.arange(slices.places.start, slices.places.stop)
    return jnp.concatenate([lens, pose, in_set, sheet, places])


def step_motion(
    motion: Float[ArrayLike, "3 4"],
    step: Float[ArrayLike, "6"],
    unit_mm: Float[ArrayLike, ""],
    model: PoseModel = PoseModel.RIGID,
) -> Float[ArrayLike, "3 4"]:
    """A rigid motion after a step of `Pose.retract`."""
    return Pose(motion).retract(step, model, unit_mm).cam_from_world


def retract(
    state: RigState,
    parametrization: Parametrization,
    head: Float[ArrayLike, "h"],
    boards: Float[ArrayLike, "s 6"],
) -> RigState:
    """The state after a step of what is free."""
    head, slices = head * parametrization.free, parametrization.slices
    unit_mm = parametrization.unit_mm

    def step_lens(lens: AbstractLens, basis: ArrayLike, step: ArrayLike) -> AbstractLens:
        return lens.retract(basis @ step)

    def step_all(motions: ArrayLike, steps: ArrayLike, model: PoseModel) -> ArrayLike:
        each = steps.reshape(-1, POSE_SIZE)
        return jax.vmap(lambda own, step: step_motion(own, step, unit_mm, model))(motions, each)

    by_lens = head[slices.lenses].reshape(parametrization.lens_shape)
    return RigState(
        jax.vmap(step_lens)(state.lenses, parametrization.lens_basis, by_lens),
        step_all(state.cam_from_rig, head[slices.cameras], parametrization.pose_model),
        step_all(state.rig_from_board, parametrization.boards_free * boards, PoseModel.RIGID),
        step_all(state.set_from_board, head[slices.boards], PoseModel.RIGID),
        state.sheet + parametrization.sheet_scale * head[slices.sheets],
        state.shape + unit_mm * head[slices.places].reshape(-1, 3),
    )


class Prior(NamedTuple):
    """What was known beforehand: chi-square, half its gradient and half its Hessian by the steps
    of the head."""

    cost: Float[ArrayLike, ""]
    gradient: Float[ArrayLike, "h"]
    information: Float[ArrayLike, "h h"]


def evaluate_prior(state: RigState, parametrization: Parametrization) -> Prior:
    """The prior at a state: of lenses, aims, sheets and single places; none of the rest."""
    unit_mm, cameras = parametrization.unit_mm, parametrization.lens_of_camera.shape[0]
    known, slices, free = parametrization.priors, parametrization.slices, parametrization.free
    parameters = jax.vmap(lambda lens: jnp.asarray(lens.parameters))(state.lenses)
    lenses = jax.vmap(_gaussian)(
        parameters - known.lens_mean, known.lens_information, parametrization.lens_basis
    )
    aim_mm = jnp.zeros((cameras, 2))
    if parametrization.pose_model is not PoseModel.RIGID:
        aim_mm = jax.vmap(lambda pose: Pose(pose).aim_mm)(jnp.asarray(state.cam_from_rig))
    # The aim is what the last two steps of AIM_FREE change.
    poses = jax.vmap(lambda aim, each: _gaussian(aim, each * jnp.eye(2), unit_mm * _AIM_STEPS))(
        aim_mm, known.aim_information
    )
    in_set = slices.boards.stop - slices.boards.start
    sheet = _gaussian(state.sheet, known.sheet_information, jnp.diag(parametrization.sheet_scale))
    steps = unit_mm * jnp.eye(3 * state.shape.shape[0])
    shape = _gaussian(state.shape.ravel(), jnp.asarray(known.shape_information), steps)
    gradient = jnp.concatenate(
        [
            *(lenses.gradient.ravel(), poses.gradient.ravel(), jnp.zeros(in_set)),
            *(sheet.gradient, shape.gradient),
        ]
    )
    information = block_diag(
        *(*lenses.information, *poses.information, jnp.zeros((in_set, in_set))),
        *(sheet.information, shape.information),
    )
    cost = jnp.sum(lenses.cost) + jnp.sum(poses.cost) + sheet.cost + shape.cost
    return Prior(cost, free * gradient, free[:, None] * information * free[None, :])


def _gaussian(
    offset: Float[ArrayLike, "n"],
    precision: Float[ArrayLike, "n n"],
    by_step: Float[ArrayLike, "n m"],
) -> Prior:
    """A normal law: `offset` from its mean, and the change of the values by a step."""
    weighted = precision @ offset
    return Prior(offset @ weighted, by_step.T @ weighted, by_step.T @ precision @ by_step)
