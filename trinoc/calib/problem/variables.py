"""Unknowns of a calibration, and their local coordinates.

Cameras observe a board in shots. The *shared parameters* (in the code also `head`) are the unknowns
that all shots have in common: lenses, camera poses, poses of boards in a set, print and bend of
each board, and displacements of single board points. Each shot has a *block*: the pose of the
board. A step is a small change of the unknowns in local coordinates. `Parametrization.free` selects
the parameters that are estimated; `Priors` contains the knowledge before the fit.
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
    """Values of all unknowns of a calibration problem.

    Attributes
    ----------
    lenses : l lenses of one model, stacked along the first axis of their fields.
    cam_from_rig : (c, 3, 4) pose of each camera.
    rig_from_board : (s, 3, 4) pose of the board in each shot; for a set of boards that are fixed to
        each other, pose of the set.
    set_from_board : (b, 3, 4) pose of each board in its set; no rows for a single board.
    sheet : (b * w,) print and bend parameters of each board (`AbstractSheet`).
    shape : (p, 3) X, Y and Z displacement of each board point from the position that `sheet`
        predicts, mm; no rows if points are not displaced.
    """

    lenses: AbstractLens
    cam_from_rig: Float[ArrayLike, "c 3 4"]
    rig_from_board: Float[ArrayLike, "s 3 4"]
    set_from_board: Float[ArrayLike, "_b 3 4"]
    sheet: Float[ArrayLike, "w"]
    shape: Float[ArrayLike, "p 3"]


class Priors(eqx.Module):
    """Gaussian priors of the unknowns. Information is inverse covariance, and 0 without a prior.

    Attributes
    ----------
    lens_mean : (l, q) mean of the parameters of each lens.
    lens_information : (l, q, q) information of the parameters of each lens.
    sheet_information : (b * w, b * w) information of `RigState.sheet`; its mean is 0.
    shape_information : (3p, 3p) information of `RigState.shape`; its mean is 0. No rows if points
        are not displaced.
    aim_information : (c,) information, 1/mm^2, of each coordinate of a camera's aim: the
        intersection of its optical axis with Z = 0. The mean is the origin.
    """

    lens_mean: Float[ArrayLike, "l q"]
    lens_information: Float[ArrayLike, "l q q"]
    sheet_information: Float[ArrayLike, "w w"]
    shape_information: Float[ArrayLike, "m m"]
    aim_information: Float[ArrayLike, "c"]


class ParameterSlices(NamedTuple):
    """Index range of each kind of unknown in the vector of shared parameters, in this order.

    Shared parameters are the unknowns that all shots have in common, in local coordinates.

    Attributes
    ----------
    lenses : `lens_size` parameters of each lens.
    cameras : POSE_SIZE parameters of each camera pose.
    boards : POSE_SIZE parameters of the pose of each board relative to the set of boards that are
        fixed to each other; none for a single board.
    sheets : print and bend parameters of each board.
    points : 3 displacements of each board point.
    lens_size : number of parameters of one lens.
    """

    lenses: slice
    cameras: slice
    boards: slice
    sheets: slice
    points: slice
    lens_size: int

    def lens(self, index: int) -> slice:
        """Index range of the parameters of one lens in the vector of shared parameters."""
        return _part(self.lenses, index, self.lens_size)

    def camera(self, index: int) -> slice:
        """Index range of the pose parameters of one camera in the vector of shared parameters."""
        return _part(self.cameras, index, POSE_SIZE)


def _part(section: slice, index: int, size: int) -> slice:
    first = section.start + index * size
    return slice(first, first + size)


class Parametrization(eqx.Module):
    """Local coordinates of the unknowns: scales, priors, and the mask of estimated parameters.

    A small change of the unknowns is a vector of h shared parameters (lenses, camera poses,
    relative poses of boards that are fixed to each other, board shape) and 6 parameters of the
    board pose of each shot.

    Attributes
    ----------
    lens_basis : (l, q, r) change of the q parameters of each lens for a unit change of its r local
        coordinates. It is either diagonal, or the factor of a covariance, with local coordinates in
        standard deviations.
    unit_mm : length that corresponds to a unit change of a translation.
    sheet_model : model of print and bend of a board.
    sheet_scale : (b * w,) change of `RigState.sheet` for a unit change of its local coordinates.
    lens_of_camera : (c,) index of each camera's lens.
    free : (h,) 1 for an estimated shared parameter, 0 for a fixed one.
    boards_free : 1 if the board poses of the shots are estimated, 0 if they are fixed.
    priors : priors of the unknowns.
    pose_model : local coordinates of camera poses: RIGID, or AIM_FREE for cameras that look at a
        fixed sheet.
    has_circles : whether some board points are circles.
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
        """Number of lenses, and number of local coordinates of each lens."""
        lenses, _, steps = self.lens_basis.shape
        return lenses, steps

    @property
    def lens_scale(self) -> Float[ArrayLike, "l q"]:
        """Change of each lens parameter for a unit change of its local coordinate, (l, q).

        Only valid if `lens_basis` is diagonal.
        """
        return self.lens_basis.diagonal(axis1=1, axis2=2)

    @property
    def boards(self) -> int:
        """Number of boards."""
        return self.sheet_scale.shape[0] // len(self.sheet_model.names)

    @property
    def slices(self) -> ParameterSlices:
        """Index range of each kind of parameter (lenses, cameras, ...) in the vector of shared
        parameters.

        Shared parameters are those that all shots have in common: lenses, camera poses, relative
        poses of boards that are fixed to each other, and board shape.
        """
        lenses, lens_size = self.lens_shape
        sizes = (
            lenses * lens_size,
            POSE_SIZE * self.lens_of_camera.shape[0],
            POSE_SIZE * self.boards if self.boards > 1 else 0,
            self.sheet_scale.shape[0],
        )
        cameras, boards, sheets, points = itertools.accumulate(sizes)
        return ParameterSlices(
            lenses=slice(0, cameras),
            cameras=slice(cameras, boards),
            boards=slice(boards, sheets),
            sheets=slice(sheets, points),
            points=slice(points, self.free.shape[0]),
            lens_size=lens_size,
        )


def parameter_columns(
    parametrization: Parametrization, camera: Int[ArrayLike, ""], board: Int[ArrayLike, ""]
) -> Int[Array, "k"]:
    """Indices, (k,), of the shared parameters on which the pixels of one observation depend.

    Shared parameters are those that all shots share. The order is: lens of the camera, pose of the
    camera, pose of the board in its set, print and bend of the board, displacements of all board
    points.

    camera : index of the camera.
    board : index of the board in its set.
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
    """Rigid motion after a small change of its local coordinates (`Pose.retract`).

    step : (6,) change. unit_mm : length of a unit change of the translation.
    """
    return Pose(motion).retract(step, model, unit_mm).cam_from_world


def retract(
    state: RigState,
    parametrization: Parametrization,
    head: Float[ArrayLike, "h"],
    boards: Float[ArrayLike, "s 6"],
) -> RigState:
    """Change all estimated unknowns by a small step.

    head : (h,) change of the shared parameters (lenses, cameras, board shape).
    boards : (s, 6) change of the board pose of each shot.
    """
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
    """Cost of the priors with its derivatives with respect to the h shared parameters.

    Attributes
    ----------
    cost : chi-square of the priors.
    gradient : (h,) half the gradient of the cost.
    information : (h, h) half the Hessian of the cost.
    """

    cost: Float[ArrayLike, ""]
    gradient: Float[ArrayLike, "h"]
    information: Float[ArrayLike, "h h"]


def evaluate_prior(state: RigState, parametrization: Parametrization) -> Prior:
    """Evaluate the priors of lenses, aims, print and bend, and board point displacements at a
    state.
    """
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
    """Evaluate one Gaussian prior.

    offset : (n,) values minus their prior mean.
    precision : (n, n) inverse covariance of the values.
    by_step : (n, m) derivative of the values with respect to their local coordinates.
    """
    weighted = precision @ offset
    return Prior(offset @ weighted, by_step.T @ weighted, by_step.T @ precision @ by_step)
