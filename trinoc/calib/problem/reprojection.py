"""Predicted minus observed pixels of the board points of one observation, and their Jacobian."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.calib.problem.sheet import AbstractSheet
from trinoc.calib.problem.variables import (
    POSE_SIZE,
    Parametrization,
    RigState,
    parameter_columns,
    step_motion,
)
from trinoc.calib.problem.views import ObservationTable
from trinoc.geometry.image_of_circle import circle_centre_offset
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss


class BoardProjection(eqx.Module):
    """Lens, poses and board shape that determine the pixels of one observation.

    Attributes
    ----------
    lens : lens of the camera.
    cam_from_rig : pose of the camera.
    rig_from_board : pose of the board; for a set of boards that are fixed to each other, pose of
        the set.
    set_from_board : pose of the board in its set; None for a single board.
    shape : (w,) print and bend parameters of the board (`AbstractSheet`).
    """

    lens: AbstractLens
    cam_from_rig: Float[ArrayLike, "3 4"]
    rig_from_board: Float[ArrayLike, "3 4"]
    set_from_board: Float[ArrayLike, "3 4"] | None
    shape: Float[ArrayLike, "w"]

    def retract(
        self, parametrization: Parametrization, step: Float[ArrayLike, "k"]
    ) -> "BoardProjection":
        """Projection after a small change of its parameters.

        step : (k,) change, in this order: lens, camera pose, `set_from_board` if it is not None,
            print and bend of the board, `rig_from_board`.
        """
        terms, unit = len(parametrization.sheet_model.names), parametrization.unit_mm
        poses = [POSE_SIZE] * (2 if self.set_from_board is None else 3)
        of_lens = step.shape[0] - sum(poses) - terms
        sizes = [of_lens, *poses[:-1], terms, POSE_SIZE]
        by_lens, by_camera, *by_set, by_sheet, by_board = jnp.split(step, np.cumsum(sizes)[:-1])
        in_set = self.set_from_board
        return BoardProjection(
            self.lens.retract(by_lens),
            step_motion(self.cam_from_rig, by_camera, unit, parametrization.pose_model),
            step_motion(self.rig_from_board, by_board, unit),
            None if in_set is None else step_motion(in_set, by_set[0], unit),
            self.shape + parametrization.sheet_scale[:terms] * by_sheet,
        )

    def project(
        self,
        point_mm: Float[ArrayLike, "3"],
        displacement_mm: Float[ArrayLike, "3"],
        sheet: AbstractSheet,
        board: ArrayLike | int,
    ) -> Float[ArrayLike, "2"]:
        """Pixel of a point of the drawing.

        point_mm : the point on the drawing.
        displacement_mm : its displacement from the position that print and bend predict.
        sheet : model of print and bend.
        board : index of the board in a set.
        """
        point = sheet.point(point_mm, self.shape, board) + sheet.size(self.shape) * displacement_mm
        if self.set_from_board is not None:
            point = Pose(self.set_from_board).transform(point)
        point = Pose(self.rig_from_board).transform(point)
        return self.lens.project_ray(Pose(self.cam_from_rig).transform(point))


def board_projection(
    state: RigState, parametrization: Parametrization, camera: Any, shot: Any, board: Any
) -> BoardProjection:
    """Projection of one observation. The indices of camera, shot and board may be traced by JAX."""
    return BoardProjection(
        jax.tree.map(lambda leaf: leaf[parametrization.lens_of_camera[camera]], state.lenses),
        state.cam_from_rig[camera],
        state.rig_from_board[shot],
        state.set_from_board[board] if len(state.set_from_board) else None,
        state.sheet.reshape(-1, len(parametrization.sheet_model.names))[board],
    )


def predict_points(
    projection: BoardProjection,
    parametrization: Parametrization,
    board: ArrayLike | int,
    point_mm: Float[ArrayLike, "n 3"],
    displacement_mm: Float[ArrayLike, "n 3"],
    radius_mm: Float[ArrayLike, "n"],
    step: Float[ArrayLike, "k"] | None = None,
) -> Float[Array, "n 2"]:
    """Predict the pixels of board points, (n, 2), optionally after a small change of the
    parameters.

    Parameters
    ----------
    projection : lens, poses and board shape.
    parametrization : units of the parameters.
    board : index of the board in a set.
    point_mm : positions on the drawing.
    displacement_mm : displacement of each point from the position that print and bend predict.
    radius_mm : radius of each circle; 0 for a corner. For a circle, the centre of its elliptical
        image is predicted, which is not the image of its centre.
    step : (k,) small change of the parameters, as in `BoardProjection.retract`.

    Notes
    -----
    The offset between both centres of a circle is constant during a step. It changes a thousand
    times less than the points.
    """
    stepped = projection if step is None else projection.retract(parametrization, step)
    sheet = parametrization.sheet_model

    def image(point: ArrayLike, displacement: ArrayLike) -> ArrayLike:
        return stepped.project(point, displacement, sheet, board)

    predicted = jnp.asarray(jax.vmap(image)(point_mm, displacement_mm))
    if not parametrization.has_circles:
        return predicted
    fixed_projection, fixed_displacement_mm = jax.lax.stop_gradient((projection, displacement_mm))

    def offset(point: Array, displacement: ArrayLike, radius: ArrayLike) -> ArrayLike:
        def on_circle(xy_mm: ArrayLike) -> ArrayLike:
            return fixed_projection.project(jnp.append(xy_mm, point[2]), displacement, sheet, board)

        return circle_centre_offset(on_circle, point[:2], radius)

    return predicted + jnp.asarray(
        jax.vmap(offset)(jnp.asarray(point_mm), fixed_displacement_mm, radius_mm)
    )


def residuals_px(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> Float[Array, "v n 2"]:
    """Predicted minus observed pixels of all n board points in v observations, (v, n, 2)."""
    return jax.vmap(lambda view: _residuals(state, parametrization, view))(table)


def whitened_residuals(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> Float[Array, "v n 2"]:
    """Predicted minus observed pixels in units of their sigmas, (v, n, 2); 0 for unused points."""

    def of_view(view: ObservationTable) -> Array:
        return _whiten(view.whitening, _residuals(state, parametrization, view)[..., None])[..., 0]

    return jax.vmap(of_view)(table)


class LinearisedObservation(eqx.Module):
    """Whitened residuals of one observation and their Jacobian.

    The observation depends on k shared parameters (lenses, cameras, board shape). The first m of
    these move all points of the image. The others are displacements of single board points.

    Attributes
    ----------
    columns : (k,) indices of these parameters in the vector of all shared parameters.
    jacobian : (n, 2, m + 6) derivative with respect to the m parameters and to the 6 of the board
        pose, whether estimated or not.
    by_points : derivative with respect to board point displacements. If the points have independent
        errors: with respect to the point's own displacement, (n, 2, 3). Otherwise whitening mixes
        the points: with respect to the displacements of all board points, (n, 2, k - m).
    point : (n,) index of each board point.
    residual : (n, 2) predicted minus observed pixels, in sigmas.
    """

    columns: Array
    jacobian: Float[Array, "n 2 _m"]
    by_points: Float[Array, "n 2 _p"]
    point: Array
    residual: Float[Array, "n 2"]

    @property
    def is_of_point(self) -> Float[Array, "n p"]:
        """Matrix (n, p) with 1 if observed point n is board point p, else 0."""
        count = (len(self.columns) - self.jacobian.shape[-1] + POSE_SIZE) // 3
        return (self.point[:, None] == jnp.arange(count)[None]).astype(self.jacobian.dtype)

    @property
    def by_all_points(self) -> Float[Array, "n 2 p"]:
        """Derivative of the residuals with respect to the 3-D displacements of all board points,
        (n, 2, 3 times the number of board points).
        """
        is_of_point = self.is_of_point
        if self.by_points.shape[-1] == 3 * is_of_point.shape[1]:
            return self.by_points
        products = is_of_point[:, None, :, None] * self.by_points[:, :, None, :]
        return products.reshape(*self.by_points.shape[:2], -1)

    def weigh(
        self, parametrization: Parametrization, loss: AbstractRobustLoss
    ) -> tuple[Float[Array, "k k"], Float[Array, "k"]]:
        """Information J^T W J and gradient J^T W r of this observation.

        The order of rows is: the k parameters of `columns`, then 6 parameters of the board pose.
        Entries of fixed parameters are 0. W is the weight of each point from the robust loss.
        """
        board_free, first = (
            jnp.full(POSE_SIZE, parametrization.boards_free),
            self.jacobian.shape[-1] - POSE_SIZE,
        )
        head_free, points_free = jnp.split(jnp.asarray(parametrization.free)[self.columns], [first])
        weight = loss.weight(jnp.sum(jnp.square(self.residual), axis=-1))[:, None, None]
        jacobian = jnp.concatenate([head_free, board_free])[None, None] * self.jacobian
        scaled = weight * jacobian
        information = jnp.einsum("nik,nil->kl", scaled, jacobian)
        gradient = jnp.einsum("nik,ni->k", scaled, self.residual)
        if not len(points_free):
            return information, gradient
        is_of_point = self.is_of_point
        if self.by_points.shape[-1] == len(points_free):
            by_points = points_free[None, None] * self.by_points
            across = jnp.einsum("nik,nij->kj", scaled, by_points)
            inner = jnp.einsum("nij,nil->jl", weight * by_points, by_points)
            point_gradient = jnp.einsum("nij,ni->j", weight * by_points, self.residual)
        else:
            # Each board point moves only its own image.
            point_derivatives = (is_of_point @ points_free.reshape(-1, 3))[:, None] * self.by_points
            products = jnp.einsum("nij,nil->njl", weight * point_derivatives, point_derivatives)
            inner = jnp.einsum(
                "np,njl,pq->pjql", is_of_point, products, jnp.eye(is_of_point.shape[1])
            )
            inner = inner.reshape(len(points_free), -1)
            across = jnp.einsum("nik,nij->nkj", scaled, point_derivatives)
            across = jnp.einsum("np,nkj->kpj", is_of_point, across).reshape(-1, len(points_free))
            point_gradient = jnp.einsum("nij,ni->nj", weight * point_derivatives, self.residual)
            point_gradient = (is_of_point.T @ point_gradient).reshape(-1)
        head, board = slice(None, first), slice(first, None)
        information = jnp.block(
            [
                [information[head, head], across[head], information[head, board]],
                [across[head].T, inner, across[board].T],
                [information[board, head], across[board], information[board, board]],
            ]
        )
        return information, jnp.concatenate([gradient[head], point_gradient, gradient[board]])


def linearise(
    state: RigState, parametrization: Parametrization, view: ObservationTable
) -> LinearisedObservation:
    """Linearise the residuals of one observation with respect to all parameters that it depends on.

    view : one row of an observation table.
    """
    point_count, poses = len(state.shape), 3 if len(state.set_from_board) else 2
    basis = jnp.asarray(parametrization.lens_basis)[parametrization.lens_of_camera[view.camera]]
    others = poses * POSE_SIZE + len(parametrization.sheet_model.names)
    # Control points of splined lenses are many, and pixels are linear in them.
    linear = state.lenses.control_count if isinstance(state.lenses, AbstractSplinedLens) else 0
    curved = basis.shape[1] - linear

    def residual_after(step: Float[Array, "k"]) -> tuple[Array, Array]:
        model_step = jnp.concatenate(
            [basis[:, :curved] @ step[:curved], step[curved : curved + others]]
        )
        displacement_mm = parametrization.unit_mm * step[curved + others :] if point_count else None
        residual = _residuals(state, parametrization, view, model_step, displacement_mm)
        return residual, residual

    zero = jnp.zeros(curved + others + (3 if point_count else 0), basis.dtype)
    jacobian, residual = jax.jacfwd(residual_after, has_aux=True)(zero)
    by_lens, by_rest, by_displacement = jnp.split(jacobian, [curved, curved + others], axis=-1)
    if linear:
        by_control = jnp.diagonal(basis)[None, None, curved:] * _by_control(
            state, parametrization, view
        )
        by_lens = jnp.concatenate([by_lens, by_control], axis=-1)
    columns_and_residual = jnp.concatenate([by_lens, by_rest, residual[..., None]], axis=-1)
    standard = _whiten(view.whitening, columns_and_residual)
    columns = parameter_columns(parametrization, view.camera, view.board)
    linearised = LinearisedObservation(
        columns, standard[..., :-1], by_displacement, jnp.asarray(view.point), standard[..., -1]
    )
    errors_are_joint = view.whitening.shape[-1] > 2
    by_points = linearised.by_all_points if errors_are_joint else by_displacement
    return eqx.tree_at(lambda n: n.by_points, linearised, _whiten(view.whitening, by_points))


def _residuals(
    state: RigState,
    parametrization: Parametrization,
    view: ObservationTable,
    step: Float[ArrayLike, "k"] | None = None,
    displacement_mm: Float[ArrayLike, "3"] | None = None,
) -> Float[Array, "n 2"]:
    """Predicted minus observed pixels, optionally after a change of the parameters.

    step : (k,) change, as in `BoardProjection.retract`.
    displacement_mm : additional displacement, the same for all points.
    """
    # Pieces of lines, and all points of a board that is as drawn, have no displacement.
    no_displacement = len(state.shape)
    shape = jnp.concatenate([jnp.asarray(state.shape), jnp.zeros((1, 3), view.uv_px.dtype)])
    displacements = shape[jnp.minimum(view.point, no_displacement)]
    projection = board_projection(state, parametrization, view.camera, view.shot, view.board)
    predicted = predict_points(
        projection,
        parametrization,
        view.board,
        view.point_mm,
        displacements if displacement_mm is None else displacements + displacement_mm[None],
        view.radius_mm,
        step,
    )
    return predicted - view.uv_px


def _whiten(whitening: Float[ArrayLike, "g k k"], columns: Float[ArrayLike, "n 2 c"]) -> Array:
    """Whiten c columns of pixel coordinates of n points: residuals or derivatives, (n, 2, c).

    Returns the columns in units of sigmas, (n, 2, c).

    whitening : (g, k, k) whitening matrix of each of g groups of points, as in `ObservationTable`.
    """
    grouped = columns.reshape(*whitening.shape[:2], columns.shape[-1])
    # Unused points may lie where the lens has no image.
    is_used = jnp.any(whitening != 0, axis=1)[..., None]
    standard = jnp.einsum("gij,gjc->gic", whitening, jnp.where(is_used, grouped, 0.0))
    return standard.reshape(columns.shape)


def _by_control(
    state: RigState, parametrization: Parametrization, view: ObservationTable
) -> Float[Array, "n 2 k"]:
    """Derivative of the pixels of n points by the k control coordinates of a splined lens."""
    assert isinstance(state.lenses, AbstractSplinedLens)
    cores = eqx.tree_at(lambda s: s.lenses, state, jax.vmap(lambda lens: lens.core)(state.lenses))
    of_core_px = _residuals(cores, parametrization, view) + view.uv_px
    lens = jax.tree.map(
        lambda leaf: leaf[parametrization.lens_of_camera[view.camera]], state.lenses
    )
    return jax.vmap(lens.by_control)(of_core_px)
