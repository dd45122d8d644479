"""Unknowns of a calibration, and the small steps that change them.

Cameras observe a board in shots. The unknowns that all shots share are the *head*: lenses, camera
poses, poses of boards in a set, print and bend of each board, and displacements of single board
points. Each shot has a *block*: the pose of the board. `Parametrization.free` states which are
estimated; `Priors` states what is known before the fit.
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
# numerical: steps of a pose that move its aim.
_AIM_STEPS = np.eye(POSE_SIZE)[4:]


class RigState(eqx.Module):
    """Values of all unknowns.

    Attributes
    ----------
    lenses : l lenses of one model, along the first axis of their fields.
    cam_from_rig : (c, 3, 4) pose of each camera.
    rig_from_board : (s, 3, 4) pose of the board in each shot; for a set, of the set's frame.
    set_from_board : (b, 3, 4) pose of each board in its set; no rows for a single board.
    sheet : (b * w,) parameters of each board's `AbstractSheet`.
    shape : (p, 3) displacement of each board point from the drawing with its `sheet`, X, Y and Z in
        mm; no rows without displacements.
    """

    lenses: AbstractLens
    cam_from_rig: Float[ArrayLike, "c 3 4"]
    rig_from_board: Float[ArrayLike, "s 3 4"]
    set_from_board: Float[ArrayLike, "_b 3 4"]
    sheet: Float[ArrayLike, "w"]
    shape: Float[ArrayLike, "p 3"]


class Priors(eqx.Module):
    """Gaussian priors of the unknowns.

    Attributes
    ----------
    lens_mean : (l, q) mean of each lens's parameters.
    lens_information : (l, q, q) their inverse covariance; zero without a prior.
    sheet_information : (w, w) inverse covariance of `RigState.sheet`, whose mean is 0.
    shape_information : (3p, 3p) inverse covariance of `RigState.shape`, whose mean is 0; no rows
        without displacements.
    aim_information : (c,) inverse variance, 1/mm^2, of each coordinate of the intersection of an
        optical axis with Z = 0; its mean is the origin.
    """

    lens_mean: Float[ArrayLike, "l q"]
    lens_information: Float[ArrayLike, "l q q"]
    sheet_information: Float[ArrayLike, "w w"]
    shape_information: Float[ArrayLike, "m m"]
    aim_information: Float[ArrayLike, "c"]


class HeadSlices(NamedTuple):
    """Positions of the steps of each kind of unknown in the head, in their order.

    Attributes
    ----------
    lenses : `lens_size` steps for each lens.
    cameras : POSE_SIZE steps for each camera's pose.
    boards : POSE_SIZE steps for the pose of each board in its set; none for a single board.
    sheets : steps of the print and bend of each board.
    points : 3 steps for each board point.
    lens_size : steps of one lens.
    """

    lenses: slice
    cameras: slice
    boards: slice
    sheets: slice
    points: slice
    lens_size: int

    def lens(self, number: int) -> slice:
        """Steps of one lens."""
        return _part(self.lenses, number, self.lens_size)

    def camera(self, number: int) -> slice:
        """Steps of one camera's pose."""
        return _part(self.cameras, number, POSE_SIZE)


def _part(section: slice, number: int, size: int) -> slice:
    first = section.start + number * size
    return slice(first, first + size)


class Parametrization(eqx.Module):
    """Map from steps to changes of the unknowns, and which steps are free.

    Attributes
    ----------
    lens_basis : (l, q, r) change of each lens's q parameters by its r steps: a diagonal of units,
        or the factor of a covariance, whose steps are in standard deviations.
    unit_mm : length of a unit step in translations.
    sheet_model : model of print and bend of a board.
    sheet_scale : (w,) change of `RigState.sheet` for a unit step.
    lens_of_camera : (c,) index of each camera's lens.
    free : (h,) 1 for free steps of the head, 0 for fixed ones.
    boards_free : 1 if the boards of the shots move, 0 if they are fixed.
    priors : priors of the unknowns.
    pose_model : parametrization of camera steps: RIGID, or AIM_FREE over a fixed sheet.
    has_circles : whether some board point is a circle.
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
        """Number of lenses, and number of steps of each."""
        lenses, _, steps = self.lens_basis.shape
        return lenses, steps

    @property
    def lens_scale(self) -> Float[ArrayLike, "l q"]:
        """Change of each lens parameter for a step of 1, (l, q).

        Only if every step changes one parameter.
        """
        return self.lens_basis.diagonal(axis1=1, axis2=2)

    @property
    def boards(self) -> int:
        """Number of boards."""
        return self.sheet_scale.shape[0] // len(self.sheet_model.names)

    @property
    def slices(self) -> HeadSlices:
        """Positions of the steps of each kind of unknown in the head."""
        lenses, lens_size = self.lens_shape
        sizes = (
            lenses * lens_size,
            POSE_SIZE * self.lens_of_camera.shape[0],
            POSE_SIZE * self.boards if self.boards > 1 else 0,
            self.sheet_scale.shape[0],
        )
        cameras, boards, sheets, points = itertools.accumulate(sizes)
        return HeadSlices(
            lenses=slice(0, cameras),
            cameras=slice(cameras, boards),
            boards=slice(boards, sheets),
            sheets=slice(sheets, points),
            points=slice(points, self.free.shape[0]),
            lens_size=lens_size,
        )


def head_columns(
    parametrization: Parametrization, camera: Int[ArrayLike, ""], board: Int[ArrayLike, ""]
) -> Int[Array, "k"]:
    """Columns of the head whose steps move the board points of one image.

    These are the steps of the camera's lens and pose, of the board's pose in its set, of its sheet,
    and of all board points.
    """
    slices, terms = parametrization.slices, len(parametrization.sheet_model.names)
    size = slices.lens_size
    lens = parametrization.lens_of_camera[camera] * size + jnp.arange(size)
    pose = slices.cameras.start + camera * POSE_SIZE + jnp.arange(POSE_SIZE)
    in_set = jnp.zeros(0, int)
    if parametrization.boards > 1:
        in_set = slices.boards.start + board * POSE_SIZE + jnp.arange(POSE_SIZE)
    sheet = slices.sheets.start + board * terms + jnp.arange(terms)
    points = jnp.arange(slices.points.start, slices.points.stop)
    return jnp.concatenate([lens, pose, in_set, sheet, points])


def step_motion(
    motion: Float[ArrayLike, "3 4"],
    step: Float[ArrayLike, "6"],
    unit_mm: Float[ArrayLike, ""],
    model: PoseModel = PoseModel.RIGID,
) -> Float[ArrayLike, "3 4"]:
    """Rigid motion after a step of `Pose.retract`."""
    return Pose(motion).retract(step, model, unit_mm).cam_from_world


def retract(
    state: RigState,
    parametrization: Parametrization,
    head: Float[ArrayLike, "h"],
    boards: Float[ArrayLike, "s 6"],
) -> RigState:
    """State after a step of the free unknowns."""
    head, slices = head * parametrization.free, parametrization.slices
    unit_mm = parametrization.unit_mm

    def step_lens(lens: AbstractLens, basis: ArrayLike, step: ArrayLike) -> AbstractLens:
        return lens.retract(basis @ step)

    def step_all(motions: ArrayLike, steps: ArrayLike, model: PoseModel) -> ArrayLike:
        pose_steps = steps.reshape(-1, POSE_SIZE)
        return jax.vmap(lambda motion, step: step_motion(motion, step, unit_mm, model))(
            motions, pose_steps
        )

    by_lens = head[slices.lenses].reshape(parametrization.lens_shape)
    return RigState(
        jax.vmap(step_lens)(state.lenses, parametrization.lens_basis, by_lens),
        step_all(state.cam_from_rig, head[slices.cameras], parametrization.pose_model),
        step_all(state.rig_from_board, parametrization.boards_free * boards, PoseModel.RIGID),
        step_all(state.set_from_board, head[slices.boards], PoseModel.RIGID),
        state.sheet + parametrization.sheet_scale * head[slices.sheets],
        state.shape + unit_mm * head[slices.points].reshape(-1, 3),
    )


class Prior(NamedTuple):
    """Chi-square of the priors, half its gradient and half its Hessian by the steps of the head."""

    cost: Float[ArrayLike, ""]
    gradient: Float[ArrayLike, "h"]
    information: Float[ArrayLike, "h h"]


def evaluate_prior(state: RigState, parametrization: Parametrization) -> Prior:
    """Prior at a state: of lenses, aims, sheets and displacements of board points."""
    unit_mm, cameras = parametrization.unit_mm, parametrization.lens_of_camera.shape[0]
    priors, slices, free = parametrization.priors, parametrization.slices, parametrization.free
    parameters = jax.vmap(lambda lens: jnp.asarray(lens.parameters))(state.lenses)
    lenses = jax.vmap(_gaussian)(
        parameters - priors.lens_mean, priors.lens_information, parametrization.lens_basis
    )
    aim_mm = jnp.zeros((cameras, 2))
    if parametrization.pose_model is not PoseModel.RIGID:
        aim_mm = jax.vmap(lambda pose: Pose(pose).aim_mm)(jnp.asarray(state.cam_from_rig))
    # The last two steps of AIM_FREE change the aim.
    poses = jax.vmap(
        lambda aim, information: _gaussian(aim, information * jnp.eye(2), unit_mm * _AIM_STEPS)
    )(aim_mm, priors.aim_information)
    in_set = slices.boards.stop - slices.boards.start
    sheet = _gaussian(state.sheet, priors.sheet_information, jnp.diag(parametrization.sheet_scale))
    steps = unit_mm * jnp.eye(3 * state.shape.shape[0])
    shape = _gaussian(state.shape.ravel(), jnp.asarray(priors.shape_information), steps)
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
    """Gaussian prior. offset : from its mean. by_step : derivative of the values by a step."""
    weighted = precision @ offset
    return Prior(offset @ weighted, by_step.T @ weighted, by_step.T @ precision @ by_step)
