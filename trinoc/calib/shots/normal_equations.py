"""Gauss-Newton's equations of all views: an arrow from which every shot's board is eliminated.

The head holds the lenses, the cameras and the sheet; each block the board's pose in one shot.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from trinoc.calib.shots.residual import view_residuals
from trinoc.calib.shots.state import POSE_SIZE, SHEET_SIZE, Chart, RigState, head_columns
from trinoc.calib.shots.table import ViewTable
from trinoc.numerics import AbstractRobustLoss, ArrayLike, BlockArrow


class ShotEquations(NamedTuple):
    """`information` times the step is minus `gradient`, over (head (h,), boards (s, 6))."""

    information: BlockArrow
    gradient: tuple[Float[ArrayLike, "h"], Float[ArrayLike, "s 6"]]


def whitened_residuals(state: RigState, chart: Chart, table: ViewTable) -> Float[Array, "v n 2"]:
    """Residuals of all places in units of their sigmas; zero where unused."""
    return jax.vmap(lambda *view: _whitened(state, chart, *view))(*table)


def residuals_px(state: RigState, chart: Chart, table: ViewTable) -> Float[ArrayLike, "v n 2"]:
    """Predicted minus observed, of all places."""
    return jax.vmap(lambda *view: _residuals(state, chart, *view))(*table)


def cost(
    state: RigState, chart: Chart, table: ViewTable, loss: AbstractRobustLoss
) -> Float[Array, ""]:
    """Robust chi-square of all places, and that of the sheet's prior."""
    squared = jnp.sum(jnp.square(whitened_residuals(state, chart, table)), axis=-1)
    return jnp.sum(loss.rho(squared)) + state.sheet @ chart.sheet_information @ state.sheet


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
    scale = chart.sheet_scale * chart.free[-SHEET_SIZE:]
    prior = scale[:, None] * chart.sheet_information * scale[None, :]
    head = head.at[-SHEET_SIZE:, -SHEET_SIZE:].add(prior)
    of_head = of_head.at[-SHEET_SIZE:].add(scale * (chart.sheet_information @ state.sheet))
    return ShotEquations(BlockArrow(head, coupling, blocks), (of_head, of_boards))


def _residuals(
    state: RigState, chart: Chart, camera, shot, place_mm, radius_mm, uv_px, whitening, step=None
) -> ArrayLike:
    lens = jax.tree.map(lambda leaf: leaf[chart.lens_of_camera[camera]], state.lenses)
    return view_residuals(
        lens,
        state.cam_from_rig[camera],
        state.rig_from_board[shot],
        state.sheet,
        chart,
        place_mm,
        radius_mm,
        uv_px,
        step,
    )


def _whitened(state: RigState, chart: Chart, *view, step=None) -> Array:
    whitening = view[-1]
    # Places that take no part may lie where the lens has no image.
    spoken = jnp.any(whitening != 0, axis=(1, 2))
    residual = _residuals(state, chart, *view, step=step)
    return jnp.where(spoken[:, None], jnp.einsum("nij,nj->ni", whitening, residual), 0.0)


def view_blocks(
    state: RigState, chart: Chart, loss: AbstractRobustLoss, camera, *rest
) -> tuple[ArrayLike, Array, Array]:
    """Columns of the head, J^T J and J^T r of one view over them and its board's pose."""
    columns = head_columns(chart, camera)
    lens_size = chart.lens_scale.shape[1]
    lens_scale = chart.lens_scale[chart.lens_of_camera[camera]]
    units = jnp.concatenate([lens_scale, jnp.ones(2 * POSE_SIZE + SHEET_SIZE, lens_scale.dtype)])
    taken = jnp.concatenate([chart.free[columns], jnp.ones(POSE_SIZE, lens_scale.dtype)])

    def whitened(step: Float[Array, "k"]) -> tuple[Array, Array]:
        residual = _whitened(state, chart, camera, *rest, step=units * taken * step)
        return residual, residual

    zero = jnp.zeros(lens_size + 2 * POSE_SIZE + SHEET_SIZE, lens_scale.dtype)
    jacobian, residual = jax.jacfwd(whitened, has_aux=True)(zero)
    weight = loss.weight(jnp.sum(jnp.square(residual), axis=-1))
    weighted = weight[:, None, None] * jacobian
    return (
        columns,
        jnp.einsum("nik,nil->kl", weighted, jacobian),
        jnp.einsum("nik,ni->k", weighted, residual),
    )
