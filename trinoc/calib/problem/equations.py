"""Gauss-Newton equations of all observations: a block arrow in which each shot is a block.

Lenses, cameras and board shape are shared by all shots. A block is the pose of the board in one
shot.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from trinoc.calib.problem.reprojection import linearise
from trinoc.calib.problem.solver import AbstractArrowProblem, ArrowEquations
from trinoc.calib.problem.variables import (
    POSE_SIZE,
    Parametrization,
    RigState,
    evaluate_prior,
    parameter_columns,
    retract,
)
from trinoc.calib.problem.views import ObservationTable
from trinoc.numerics.block_arrow import BlockArrow
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.robust_loss import AbstractRobustLoss


class PointsProblem(AbstractArrowProblem):
    """Least-squares problem of a rig that observes board points, with priors.

    Attributes
    ----------
    parametrization : units of the parameters, priors, and the mask of estimated parameters.
    table : all v observations.
    loss : robust loss for the points of each observation; its fields have a first axis of length v.
    """

    # numerical: state of about twenty shots.
    optimized_from: ClassVar[float] = 256

    parametrization: Parametrization
    table: ObservationTable
    loss: AbstractRobustLoss

    def equations(self, state: RigState) -> ArrowEquations:
        """Gauss-Newton equations at a state: all observations, weighted by the robust loss, and the
        priors.
        """

        def of_view(view: ObservationTable, loss: AbstractRobustLoss) -> tuple[Array, ...]:
            linearised = linearise(state, self.parametrization, view)
            squared = jnp.sum(jnp.square(linearised.residual), axis=-1)
            return (
                jnp.sum(loss.rho(squared)),
                linearised.columns,
                *linearised.weigh(self.parametrization, loss),
            )

        costs, *view_equations = jax.vmap(of_view)(self.table, self.loss)
        columns, block_information, gradient = view_equations
        size, prior = columns.shape[1], evaluate_prior(state, self.parametrization)
        # Observations of one board by one camera have the same columns: only sums are scattered.
        cameras, boards = state.cam_from_rig.shape[0], self.parametrization.boards
        kind = jnp.asarray(self.table.board) * cameras + self.table.camera
        kind_sums = jax.ops.segment_sum(block_information[:, :size, :size], kind, cameras * boards)
        kinds = jnp.arange(cameras * boards)
        columns_of_kind = jax.vmap(
            lambda k: parameter_columns(self.parametrization, k % cameras, k // cameras)
        )(kinds)
        head = (
            jnp.asarray(prior.information)
            .at[columns_of_kind[:, :, None], columns_of_kind[:, None, :]]
            .add(kind_sums)
        )
        head_gradient = jnp.asarray(prior.gradient).at[columns].add(gradient[:, :size])
        coupling, blocks, board_gradients = sum_boards(
            state, self.parametrization, self.table, *view_equations
        )
        cost = jnp.sum(costs) + prior.cost
        return ArrowEquations(
            cost, BlockArrow(head, coupling, blocks), (head_gradient, board_gradients)
        )

    def retract(
        self, state: RigState, head: Float[ArrayLike, "h"], blocks: Float[ArrayLike, "s 6"]
    ) -> RigState:
        """State after small changes of its unknowns, in local coordinates.

        head : (h,) change of the parameters that all shots share: lenses, cameras, board shape.
        blocks : (s, 6) change of the board pose in each shot.
        """
        return retract(state, self.parametrization, head, blocks)


def sum_boards(
    state: RigState,
    parametrization: Parametrization,
    table: ObservationTable,
    columns: Int[Array, "v k"],
    block_information: Float[Array, "v m m"],
    gradient: Float[Array, "v m"],
) -> tuple[Float[Array, "s h 6"], Float[Array, "s 6 6"], Float[Array, "s 6"]]:
    """Sum the normal equations that involve the pose of the board, separately for each of s shots.

    Shared parameters are those that all shots share: lenses, cameras, board shape.

    Parameters
    ----------
    columns : (v, k) indices of the shared parameters on which each observation depends.
    block_information, gradient : normal equations of each observation. The order is: these k
        parameters, then 6 parameters of the board pose.

    Returns
    -------
    The mixed second derivatives by shared parameters and board pose, the information of the board
    pose, and the gradient with respect to the board pose.
    """
    size, shot = columns.shape[1], jnp.asarray(table.shot)
    shots, heads = state.rig_from_board.shape[0], parametrization.free.shape[0]
    coupling = jnp.zeros((shots, heads, POSE_SIZE), block_information.dtype)
    coupling = coupling.at[shot[:, None], columns].add(block_information[:, :size, size:])
    blocks = jnp.zeros((shots, POSE_SIZE, POSE_SIZE), block_information.dtype)
    blocks = blocks.at[shot].add(block_information[:, size:, size:])
    board_gradients = (
        jnp.zeros((shots, POSE_SIZE), block_information.dtype).at[shot].add(gradient[:, size:])
    )
    return coupling, blocks, board_gradients
