"""Predicted minus observed places of the board in one view: the factor that all fits share."""

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
    head_columns,
    step_motion,
)
from trinoc.calib.problem.views import ViewTable
from trinoc.geometry.image_of_circle import circle_centre_offset
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.splined import AbstractSplinedLens
from trinoc.geometry.pose import Pose
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss


class BoardView(eqx.Module):
    """One camera and the board that it looks at, as some state has them.

    Fields
    ------
    lens : of the camera.
    cam_from_rig, rig_from_board : where camera and board stand.
    set_from_board : where one of several boards stands in their set; None for one board.
    shape : (w,) of the board's sheet.
    """

    lens: AbstractLens
    cam_from_rig: Float[ArrayLike, "3 4"]
    rig_from_board: Float[ArrayLike, "3 4"]
    set_from_board: Float[ArrayLike, "3 4"] | None
    shape: Float[ArrayLike, "w"]

    def retract(self, parametrization: Parametrization, step: Float[ArrayLike, "k"]) -> "BoardView":
        """This view after a step of (lens's parameters, camera, board in its set, sheet, board in
        the shot)."""
        terms, unit = len(parametrization.sheet_model.names), parametrization.unit_mm
        poses = [POSE_SIZE] * (2 if self.set_from_board is None else 3)
        of_lens = step.shape[0] - sum(poses) - terms
        sizes = [of_lens, *poses[:-1], terms, POSE_SIZE]
        by_lens, by_camera, *by_set, by_sheet, by_board = jnp.split(step, np.cumsum(sizes)[:-1])
        in_set = self.set_from_board
        return BoardView(
            self.lens.retract(by_lens),
            step_motion(self.cam_from_rig, by_camera, unit, parametrization.pose_model),
            step_motion(self.rig_from_board, by_board, unit),
            None if in_set is None else step_motion(in_set, by_set[0], unit),
            self.shape + parametrization.sheet_scale[:terms] * by_sheet,
        )

    def project(
        self,
        place_mm: Float[ArrayLike, "3"],
        aside_mm: Float[ArrayLike, "3"],
        sheet: AbstractSheet,
        board: ArrayLike | int,
    ) -> Float[ArrayLike, "2"]:
        """The pixel of a place of the drawing, which lies `aside_mm` of where the sheet has it."""
        point = sheet.point(place_mm, self.shape, board) + sheet.size(self.shape) * aside_mm
        if self.set_from_board is not None:
            point = Pose(self.set_from_board).transform(point)
        point = Pose(self.rig_from_board).transform(point)
        return self.lens.project_ray(Pose(self.cam_from_rig).transform(point))


def board_view(
    state: RigState, parametrization: Parametrization, camera: Any, shot: Any, board: Any
) -> BoardView:
    """What a camera looks at in a shot; all three are numbers, or traced ones."""
    return BoardView(
        jax.tree.map(lambda leaf: leaf[parametrization.lens_of_camera[camera]], state.lenses),
        state.cam_from_rig[camera],
        state.rig_from_board[shot],
        state.set_from_board[board] if len(state.set_from_board) else None,
        state.sheet.reshape(-1, len(parametrization.sheet_model.names))[board],
    )


def predict_places(
    here: BoardView,
    parametrization: Parametrization,
    board: ArrayLike | int,
    place_mm: Float[ArrayLike, "n 3"],
    aside_mm: Float[ArrayLike, "n 3"],
    radius_mm: Float[ArrayLike, "n"],
    step: Float[ArrayLike, "k"] | None = None,
) -> Float[Array, "n 2"]:
    """Where a view shows places, after a step where one is given.

    aside_mm : by which each place lies elsewhere on the board. radius_mm : of the circle there,
    whose image's centre is meant; 0 for a corner.

    The centre of a circle's image is not the image of its centre; by how much is taken where the
    step begins: it changes a thousand times less than the places themselves.
    """
    after = here if step is None else here.retract(parametrization, step)
    sheet = parametrization.sheet_model

    def image(place: ArrayLike, aside: ArrayLike) -> ArrayLike:
        return after.project(place, aside, sheet, board)

    predicted = jnp.asarray(jax.vmap(image)(place_mm, aside_mm))
    if not parametrization.has_circles:
        return predicted
    still, flat_mm = jax.lax.stop_gradient((here, aside_mm))

    def offset(place: Array, aside: ArrayLike, radius: ArrayLike) -> ArrayLike:
        def on_circle(xy_mm: ArrayLike) -> ArrayLike:
            return still.project(jnp.append(xy_mm, place[2]), aside, sheet, board)

        return circle_centre_offset(on_circle, place[:2], radius)

    return predicted + jnp.asarray(jax.vmap(offset)(jnp.asarray(place_mm), flat_mm, radius_mm))


def residuals_px(
    state: RigState, parametrization: Parametrization, table: ViewTable
) -> Float[Array, "v n 2"]:
    """Predicted minus observed, of all places."""
    return jax.vmap(lambda view: _residuals(state, parametrization, view))(table)


def whitened_residuals(
    state: RigState, parametrization: Parametrization, table: ViewTable
) -> Float[Array, "v n 2"]:
    """Residuals of all places in units of their sigmas; zero where unused."""

    def of_view(view: ViewTable) -> Array:
        return _whiten(view.whitening, _residuals(state, parametrization, view)[..., None])[..., 0]

    return jax.vmap(of_view)(table)


class LinearisedView(eqx.Module):
    """Places of one view, whitened, near a state.

    Fields
    ------
    columns : (k,) of the head by whose steps they change: the m that move all places of the view,
        then those of the places themselves.
    jacobian : (n, 2, m + 6) by the m and by the steps of the shot's board, whether free or not.
    by_places : by steps of places: (n, 2, 3) by each one's own where errors of places share
        nothing, else (n, 2, k - m) by all.
    place : (n,) which of the places each is.
    residual : (n, 2) predicted minus observed.
    """

    columns: Array
    jacobian: Float[Array, "n 2 _m"]
    by_places: Float[Array, "n 2 _p"]
    place: Array
    residual: Float[Array, "n 2"]

    @property
    def is_own(self) -> Float[Array, "n p"]:
        """1 where a place is that of a column, else 0."""
        count = (len(self.columns) - self.jacobian.shape[-1] + POSE_SIZE) // 3
        return (self.place[:, None] == jnp.arange(count)[None]).astype(self.jacobian.dtype)

    @property
    def by_all_places(self) -> Float[Array, "n 2 p"]:
        """By the steps of all places."""
        own = self.is_own
        if self.by_places.shape[-1] == 3 * own.shape[1]:
            return self.by_places
        every = own[:, None, :, None] * self.by_places[:, :, None, :]
        return every.reshape(*self.by_places.shape[:2], -1)

    def weigh(
        self, parametrization: Parametrization, loss: AbstractRobustLoss
    ) -> tuple[Float[Array, "k k"], Float[Array, "k"]]:
        """J^T W J and J^T W r by the free steps of the head, and then of the board; W the loss's
        weight of each place."""
        of_board, first = (
            jnp.full(POSE_SIZE, parametrization.boards_free),
            self.jacobian.shape[-1] - POSE_SIZE,
        )
        of_view, of_places = jnp.split(jnp.asarray(parametrization.free)[self.columns], [first])
        weight = loss.weight(jnp.sum(jnp.square(self.residual), axis=-1))[:, None, None]
        jacobian = jnp.concatenate([of_view, of_board])[None, None] * self.jacobian
        scaled = weight * jacobian
        information = jnp.einsum("nik,nil->kl", scaled, jacobian)
        gradient = jnp.einsum("nik,ni->k", scaled, self.residual)
        if not len(of_places):
            return information, gradient
        own = self.is_own
        if self.by_places.shape[-1] == len(of_places):
            by_places = of_places[None, None] * self.by_places
            across = jnp.einsum("nik,nij->kj", scaled, by_places)
            inner = jnp.einsum("nij,nil->jl", weight * by_places, by_places)
            pull = jnp.einsum("nij,ni->j", weight * by_places, self.residual)
        else:
            # Each moves its own image alone.
            by_own = (own @ of_places.reshape(-1, 3))[:, None] * self.by_places
            products = jnp.einsum("nij,nil->njl", weight * by_own, by_own)
            inner = jnp.einsum("np,njl,pq->pjql", own, products, jnp.eye(own.shape[1]))
            inner = inner.reshape(len(of_places), -1)
            across = jnp.einsum("nik,nij->nkj", scaled, by_own)
            across = jnp.einsum("np,nkj->kpj", own, across).reshape(-1, len(of_places))
            pull = jnp.einsum("nij,ni->nj", weight * by_own, self.residual)
            pull = (own.T @ pull).reshape(-1)
        head, board = slice(None, first), slice(first, None)
        information = jnp.block(
            [
                [information[head, head], across[head], information[head, board]],
                [across[head].T, inner, across[board].T],
                [information[board, head], across[board], information[board, board]],
            ]
        )
        return information, jnp.concatenate([gradient[head], pull, gradient[board]])


def linearise(state: RigState, parametrization: Parametrization, view: ViewTable) -> LinearisedView:
    """One view's places (a row of a table) by all steps that move them."""
    places, poses = len(state.shape), 3 if len(state.set_from_board) else 2
    basis = jnp.asarray(parametrization.lens_basis)[parametrization.lens_of_camera[view.camera]]
    others = poses * POSE_SIZE + len(parametrization.sheet_model.names)
    # Control points of splined lenses are many, and pixels are linear in them.
    linear = state.lenses.control_count if isinstance(state.lenses, AbstractSplinedLens) else 0
    curved = basis.shape[1] - linear

    def after(step: Float[Array, "k"]) -> tuple[Array, Array]:
        own = jnp.concatenate([basis[:, :curved] @ step[:curved], step[curved : curved + others]])
        aside = parametrization.unit_mm * step[curved + others :] if places else None
        residual = _residuals(state, parametrization, view, own, aside)
        return residual, residual

    zero = jnp.zeros(curved + others + (3 if places else 0), basis.dtype)
    jacobian, residual = jax.jacfwd(after, has_aux=True)(zero)
    by_lens, by_rest, by_aside = jnp.split(jacobian, [curved, curved + others], axis=-1)
    if linear:
        by_control = jnp.diagonal(basis)[None, None, curved:] * _by_control(
            state, parametrization, view
        )
        by_lens = jnp.concatenate([by_lens, by_control], axis=-1)
    every = jnp.concatenate([by_lens, by_rest, residual[..., None]], axis=-1)
    standard = _whiten(view.whitening, every)
    columns = head_columns(parametrization, view.camera, view.board)
    near = LinearisedView(
        columns, standard[..., :-1], by_aside, jnp.asarray(view.place), standard[..., -1]
    )
    share_errors = view.whitening.shape[-1] > 2
    by_places = near.by_all_places if share_errors else by_aside
    return eqx.tree_at(lambda n: n.by_places, near, _whiten(view.whitening, by_places))


def _residuals(
    state: RigState,
    parametrization: Parametrization,
    view: ViewTable,
    step: Float[ArrayLike, "k"] | None = None,
    aside_mm: Float[ArrayLike, "3"] | None = None,
) -> Float[Array, "n 2"]:
    """Predicted minus observed, after a step, and with all places `aside_mm` of their own."""
    # What is no place of the board, and every place of a board that is as drawn, lies as drawn.
    none = len(state.shape)
    shape = jnp.concatenate([jnp.asarray(state.shape), jnp.zeros((1, 3), view.uv_px.dtype)])
    own = shape[jnp.minimum(view.place, none)]
    here = board_view(state, parametrization, view.camera, view.shot, view.board)
    predicted = predict_places(
        here,
        parametrization,
        view.board,
        view.place_mm,
        own if aside_mm is None else own + aside_mm[None],
        view.radius_mm,
        step,
    )
    return predicted - view.uv_px


def _whiten(whitening: Float[ArrayLike, "g k k"], columns: Float[ArrayLike, "n 2 c"]) -> Array:
    """Columns of numbers in px in units of sigmas, two numbers to a place as before."""
    grouped = columns.reshape(*whitening.shape[:2], columns.shape[-1])
    # Places that take no part may lie where the lens has no image.
    is_used = jnp.any(whitening != 0, axis=1)[..., None]
    standard = jnp.einsum("gij,gjc->gic", whitening, jnp.where(is_used, grouped, 0.0))
    return standard.reshape(columns.shape)


def _by_control(
    state: RigState, parametrization: Parametrization, view: ViewTable
) -> Float[Array, "n 2 k"]:
    """Derivative of all places of a view by the control points of its splined lens."""
    assert isinstance(state.lenses, AbstractSplinedLens)
    cores = eqx.tree_at(lambda s: s.lenses, state, jax.vmap(lambda lens: lens.core)(state.lenses))
    of_core_px = _residuals(cores, parametrization, view) + view.uv_px
    lens = jax.tree.map(
        lambda leaf: leaf[parametrization.lens_of_camera[view.camera]], state.lenses
    )
    return jax.vmap(lens.by_control)(of_core_px)
