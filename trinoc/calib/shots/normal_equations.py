"""Gauss-Newton's equations of all views: an arrow from which every shot's board is eliminated.

The head holds the lenses, the cameras and the sheet; each block the board's pose in one shot.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from trinoc.calib.shots.residual import view_residuals
from trinoc.calib.shots.state import POSE_SIZE, SHEET_SIZE, Chart, RigState, head_columns
from trinoc.calib.shots.table import ViewTable
from trinoc.geometry import AbstractSplined
from trinoc.numerics import AbstractRobustLoss, ArrayLike, BlockArrow


class ShotEquations(NamedTuple):
    """`information` times the step is minus `gradient`, over (head (h,), boards (s, 6))."""

    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "h"], Float[ArrayLike, "s 6"]]


def whitened_residuals(state: RigState, chart: Chart, table: ViewTable) -> Float[Array, "v g k"]:
    """Residuals of all groups of places in units of their sigmas; zero where unused."""
    return jax.vmap(lambda *view: _whitened(state, chart, *view))(*table)


def residuals_px(state: RigState, chart: Chart, table: ViewTable) -> Float[ArrayLike, "v n 2"]:
    """Predicted minus observed, of all places."""
    return jax.vmap(lambda *view: _residuals(state, chart, *view))(*table)


def cost(
    state: RigState, chart: Chart, table: ViewTable, loss: AbstractRobustLoss
) -> Float[Array, ""]:
    """Robust chi-square of all groups of places, and that of what was known beforehand."""
    squared = jnp.sum(jnp.square(whitened_residuals(state, chart, table)), axis=-1)
    return jnp.sum(loss.rho(squared)) + prior_cost(state, chart)


def prior_cost(state: RigState, chart: Chart) -> Float[ArrayLike, ""]:
    """Chi-square of lenses, and of the board's sheet and places, under what was known of them."""
    lenses = jax.vmap(lambda lens: jnp.asarray(lens.parameters))(state.lenses)
    of_lenses = jnp.einsum("lp,lpq,lq->", lenses, chart.lens_information, lenses)
    of_shape = jnp.sum(jnp.square(state.shape) * chart.shape_information[None])
    return of_lenses + state.sheet @ chart.sheet_information @ state.sheet + of_shape


def shot_equations(
    state: RigState, chart: Chart, table: ViewTable, loss: AbstractRobustLoss
) -> ShotEquations:
    """The equations at a state, weighted by the loss."""
    columns, own, gradient = jax.vmap(lambda *view: view_blocks(state, chart, loss, *view))(*table)
    size = columns.shape[1]
    head = jnp.zeros((chart.free.shape[0],) * 2, own.dtype)
    head = head.at[columns[:, :, None], columns[:, None, :]].add(own[:, :size, :size])
    shots = state.rig_from_board.shape[0]
    coupling = jnp.zeros((shots, chart.free.shape[0], POSE_SIZE), own.dtype)
    coupling = coupling.at[table.shot[:, None], columns].add(own[:, :size, size:])
    blocks = jnp.zeros((shots, POSE_SIZE, POSE_SIZE), own.dtype)
    blocks = blocks.at[table.shot].add(own[:, size:, size:])
    of_head = jnp.zeros_like(chart.free).at[columns].add(gradient[:, :size])
    of_boards = jnp.zeros((shots, POSE_SIZE), own.dtype).at[table.shot].add(gradient[:, size:])
    first = chart.sheet_first
    free = chart.free[first:]
    head = head.at[first:, first:].add(free[:, None] * chart.board_prior * free[None, :])
    board = jnp.concatenate([state.sheet / chart.sheet_scale, state.shape.ravel() / chart.unit_mm])
    of_head = of_head.at[first:].add(free * (chart.board_prior @ board))
    lenses = jax.vmap(lambda lens: jnp.asarray(lens.parameters))(state.lenses)
    last, prior = chart.lens_scale.size, chart.lens_prior
    free = chart.free[:last]
    head = head.at[:last, :last].add(free[:, None] * prior * free[None, :])
    of_head = of_head.at[:last].add(free * (prior @ (lenses / chart.lens_scale).ravel()))
    return ShotEquations(BlockArrow(head, coupling, blocks), (of_head, of_boards))


def _residuals(
    state: RigState,
    chart: Chart,
    camera,
    shot,
    board,
    place,
    place_mm,
    radius_mm,
    uv_px,
    whitening,
    step=None,
    aside_mm: ArrayLike | float = 0.0,
) -> ArrayLike:
    """Predicted minus observed, after a step, and with all places `aside_mm` of their own."""
    # What is no place of the board, and every place of a board that is as drawn, lies as drawn.
    none = len(state.shape)
    shape = jnp.concatenate([jnp.asarray(state.shape), jnp.zeros((1, 3), uv_px.dtype)])
    lens = jax.tree.map(lambda leaf: leaf[chart.lens_of_camera[camera]], state.lenses)
    return view_residuals(
        lens,
        state.cam_from_rig[camera],
        state.rig_from_board[shot],
        state.sheet.reshape(-1, SHEET_SIZE)[board],
        chart,
        shape[jnp.minimum(place, none)] + aside_mm,
        place_mm,
        radius_mm,
        uv_px,
        step,
        board,
        state.set_from_board[board] if len(state.set_from_board) else None,
    )


def _whitened(state: RigState, chart: Chart, *view) -> Array:
    return _in_sigmas(view[-1], _residuals(state, chart, *view)[..., None])[..., 0]


def _in_sigmas(whitening: ArrayLike, columns: ArrayLike) -> Array:
    """Columns of numbers in px, (n, 2, c), as (g, k, c) in units of sigmas."""
    grouped = columns.reshape(*whitening.shape[:2], columns.shape[-1])
    # Places that take no part may lie where the lens has no image.
    spoken = jnp.any(whitening != 0, axis=1)[..., None]
    return jnp.einsum("gij,gjc->gic", whitening, jnp.where(spoken, grouped, 0.0))


def _by_control(state: RigState, chart: Chart, camera, *view) -> Float[Array, "n 2 k"]:
    """Derivative of all places of a view by the control points of its splined lens."""
    assert isinstance(state.lenses, AbstractSplined)
    cores = eqx.tree_at(lambda s: s.lenses, state, jax.vmap(lambda lens: lens.core)(state.lenses))
    *_, uv_px, _ = view
    of_core_px = _residuals(cores, chart, camera, *view) + uv_px
    lens = jax.tree.map(lambda leaf: leaf[chart.lens_of_camera[camera]], state.lenses)
    return jax.vmap(lens.by_control)(of_core_px)


def view_blocks(
    state: RigState, chart: Chart, loss: AbstractRobustLoss, camera, shot, board, place, *rest
) -> tuple[ArrayLike, Array, Array]:
    """Columns of the head, J^T J and J^T r of one view over them and its board's pose."""
    columns = head_columns(chart, camera, board)
    places = len(state.shape)
    lens_size = chart.lens_scale.shape[1]
    lens_scale = chart.lens_scale[chart.lens_of_camera[camera]]
    poses = 3 if len(state.set_from_board) else 2
    count = lens_size + poses * POSE_SIZE + SHEET_SIZE
    units = jnp.concatenate([lens_scale, jnp.ones(count - lens_size, lens_scale.dtype)])

    # Control points of splined lenses are many, and pixels are linear in them.
    linear = state.lenses.control_count if isinstance(state.lenses, AbstractSplined) else 0
    curved = lens_size - linear

    def after(step: Float[Array, "k"]) -> tuple[ArrayLike, ArrayLike]:
        step = jnp.concatenate([step[:curved], jnp.zeros(linear, step.dtype), step[curved:]])
        own, aside = units * step[:count], chart.unit_mm * step[None, count:]
        residual = _residuals(
            state, chart, camera, shot, board, place, *rest,
            step=own, aside_mm=aside if places else 0.0,
        )  # fmt: skip
        return residual, residual

    zero = jnp.zeros(count - linear + (3 if places else 0), lens_scale.dtype)
    jacobian, residual = jax.jacfwd(after, has_aux=True)(zero)
    if isinstance(state.lenses, AbstractSplined):
        by_control = _by_control(state, chart, camera, shot, board, place, *rest)
        by_control = lens_scale[None, None, curved:] * by_control
        parts = [jacobian[..., :curved], by_control, jacobian[..., curved:]]
        jacobian = jnp.concatenate(parts, axis=-1)
    by_head, by_board, by_aside = jnp.split(jacobian, [count - POSE_SIZE, count], axis=-1)
    # Every place moves its own image alone.
    own = place[:, None] == jnp.arange(places)[None]
    by_shape = jnp.where(own[:, None, :, None], by_aside[:, :, None, :], 0.0)
    by_shape = by_shape.reshape(*residual.shape, 3 * places)
    by_head = jnp.concatenate([by_head, by_shape], axis=-1) * chart.free[columns][None, None]
    every = jnp.concatenate([by_head, by_board, residual[..., None]], axis=-1)
    standard = _in_sigmas(rest[-1], every)
    jacobian, residual = standard[..., :-1], standard[..., -1]
    weight = loss.weight(jnp.sum(jnp.square(residual), axis=-1))
    weighted = weight[:, None, None] * jacobian
    return (
        columns,
        jnp.einsum("nik,nil->kl", weighted, jacobian),
        jnp.einsum("nik,ni->k", weighted, residual),
    )
