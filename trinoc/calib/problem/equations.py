"""Gauss-Newton's equations of all views: an arrow from which every shot's board is eliminated.

The head holds the lenses, the cameras and the sheet; each block the board's pose in one shot.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from trinoc.calib.problem.places import linearise
from trinoc.calib.problem.solver import AbstractArrowProblem, ArrowEquations
from trinoc.calib.problem.variables import (
    POSE_SIZE,
    Parametrization,
    RigState,
    evaluate_prior,
    head_columns,
    retract,
)
from trinoc.calib.problem.views import ViewTable
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss


class PlacesProblem(AbstractArrowProblem):
    """Places of boards, seen by the cameras of a rig, and what was known beforehand.

    Fields
    ------
    parametrization : units, and what is free.
    table : v views.
    loss : of each view's places, along a first axis of its fields.
    """

    # numerical: of some twenty shots.
    optimized_from: ClassVar[float] = 256

    parametrization: Parametrization
    table: ViewTable
    loss: AbstractRobustLoss

    def equations(self, state: RigState) -> ArrowEquations:
        """Summed over views, weighted by the loss, the prior included."""

        def of_view(view: ViewTable, loss: AbstractRobustLoss) -> tuple[Array, ...]:
            near = linearise(state, self.parametrization, view)
            squared = jnp.sum(jnp.square(near.residual), axis=-1)
            return jnp.sum(loss.rho(squared)), near.columns, *near.weigh(self.parametrization, loss)

        costs, *seen = jax.vmap(of_view)(self.table, self.loss)
        columns, own, gradient = seen
        size, prior = columns.shape[1], evaluate_prior(state, self.parametrization)
        # Views of one board by one camera have the same columns: sums are scattered, not views.
        cameras, boards = state.cam_from_rig.shape[0], self.parametrization.boards
        kind = jnp.asarray(self.table.board) * cameras + self.table.camera
        of_kinds = jax.ops.segment_sum(own[:, :size, :size], kind, cameras * boards)
        every = jnp.arange(cameras * boards)
        those = jax.vmap(lambda k: head_columns(self.parametrization, k % cameras, k // cameras))(
            every
        )
        head = jnp.asarray(prior.information).at[those[:, :, None], those[:, None, :]].add(of_kinds)
        of_head = jnp.asarray(prior.gradient).at[columns].add(gradient[:, :size])
        coupling, blocks, of_boards = sum_boards(state, self.parametrization, self.table, *seen)
        cost = jnp.sum(costs) + prior.cost
        return ArrowEquations(cost, BlockArrow(head, coupling, blocks), (of_head, of_boards))

    def retract(
        self, state: RigState, head: Float[ArrayLike, "h"], blocks: Float[ArrayLike, "s 6"]
    ) -> RigState:
        """The state after a step."""
        return retract(state, self.parametrization, head, blocks)


def sum_boards(
    state: RigState,
    parametrization: Parametrization,
    table: ViewTable,
    columns: Int[Array, "v k"],
    own: Float[Array, "v m m"],
    gradient: Float[Array, "v m"],
) -> tuple[Float[Array, "s h 6"], Float[Array, "s 6 6"], Float[Array, "s 6"]]:
    """Of the views' equations, summed over each shot: how its board goes with the head, its own
    information, and its gradient."""
    size, shot = columns.shape[1], jnp.asarray(table.shot)
    shots, heads = state.rig_from_board.shape[0], parametrization.free.shape[0]
    coupling = jnp.zeros((shots, heads, POSE_SIZE), own.dtype)
    coupling = coupling.at[shot[:, None], columns].add(own[:, :size, size:])
    blocks = jnp.zeros((shots, POSE_SIZE, POSE_SIZE), own.dtype)
    blocks = blocks.at[shot].add(own[:, size:, size:])
    of_boards = jnp.zeros((shots, POSE_SIZE), own.dtype).at[shot].add(gradient[:, size:])
    return coupling, blocks, of_boards
