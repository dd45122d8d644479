"""Fisher information of each shot about lenses, cameras and board, at the end of a fit."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.problem.equations import sum_boards
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.reprojection import linearise
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, RigState, evaluate_prior
from trinoc.calib.problem.views import ObservationTable
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.numerics.information import Observability, observability
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure
from trinoc.numerics.small_matrices import inverse_positive_definite


class Information(NamedTuple):
    """Fisher information of the shots about the shared parameters of a calibration.

    The h shared parameters are those of lenses, camera poses, relative poses of boards that are
    fixed to each other, and board shape, in local coordinates. The pose of the board in each of the
    s shots is eliminated (Schur complement).

    Attributes
    ----------
    shot_information : (s, h, h) information of each shot, without priors.
    gradients : (s, h) gradient of half the chi-square of each shot. At a minimum, these gradients
        and that of the priors sum to zero.
    board_by_parameters : (s, 6, h) derivative of the board pose of each shot with respect to the
        shared parameters.
    board_covariance : (s, 6, 6) covariance of the board pose of each shot for exact shared
        parameters.
    free : (f,) indices of the estimated shared parameters.
    prior : (f, f) information of the priors of the estimated parameters.
    first_shape_step : index of the first shared parameter that is a displacement of a board point.
    tuning : constants of the fitted problem.
    """

    shot_information: Float[np.ndarray, "s h h"]
    gradients: Float[np.ndarray, "s h"]
    board_by_parameters: Float[np.ndarray, "s 6 h"]
    board_covariance: Float[np.ndarray, "s 6 6"]
    free: np.ndarray
    prior: Float[np.ndarray, "f f"]
    first_shape_step: int
    tuning: CalibTuning = TUNING

    @property
    def observability(self) -> Observability:
        """Rank and covariance of the f estimated parameters of lenses, cameras and board shape."""
        return self.observability_of(np.ones(len(self.free), dtype=bool))

    def observability_of(self, rows: Bool[np.ndarray, "f"]) -> Observability:
        """Rank and covariance of some of the estimated parameters, if all others are fixed.

        rows : (f,) mask of these parameters among the f estimated parameters of lenses, cameras and
            board shape.
        """
        free = self.free[rows]
        information = (
            self.shot_information.sum(axis=0)[np.ix_(free, free)] + self.prior[np.ix_(rows, rows)]
        )
        count = len(free)
        return observability(
            0.5 * (information + information.T), np.eye(count), np.full(count, np.inf)
        )

    def restrict_to(self, rows: Bool[np.ndarray, "f"]) -> "Information":
        """Information about some of the estimated parameters, if all others are fixed.

        rows : (f,) mask of these parameters among the f estimated parameters of lenses, cameras and
            board shape.
        """
        prior = self.prior[np.ix_(rows, rows)]
        return self._replace(free=self.free[rows], prior=prior)


def compute_information(problem: Problem) -> Information:
    """Compute the Fisher information of all shots about lenses, cameras and board shape.

    It is evaluated at the state of the problem.
    """
    shot_information, gradients, board_by_parameters, board_covariance, prior = (
        np.asarray(part)
        for part in _of_shots(problem.state, problem.parametrization, problem.table)
    )
    free = np.flatnonzero(problem.free)
    prior = prior[np.ix_(free, free)]
    first = problem.slices.points.start
    return Information(
        shot_information,
        gradients,
        board_by_parameters,
        board_covariance,
        free,
        prior,
        first,
        problem.tuning,
    )


@kept_jit
def _of_shots(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> tuple[Array, ...]:
    plain = GemanMcClure.from_scale(jnp.asarray(jnp.inf))

    def of_view(view: ObservationTable) -> tuple[Array, Array, Array]:
        linearised = linearise(state, parametrization, view)
        return linearised.columns, *linearised.weigh(parametrization, plain)

    equations = jax.vmap(of_view)(table)
    columns, block_information, gradient = equations
    size, shots, heads = (
        columns.shape[1],
        state.rig_from_board.shape[0],
        parametrization.free.shape[0],
    )
    shot = jnp.asarray(table.shot)
    # Map from each step of the head to its column, the last one for steps without an effect:
    # reading by index is faster than scattering.
    column = jax.vmap(
        lambda block_information: jnp.full(heads, size).at[block_information].set(jnp.arange(size))
    )(columns)
    padded = jnp.pad(block_information[:, :size, :size], ((0, 0), (0, 1), (0, 1)))
    view_information = jax.vmap(
        lambda block_information, columns_of_view: block_information[columns_of_view][
            :, columns_of_view
        ]
    )(padded, column)
    head = jax.ops.segment_sum(view_information, shot, shots)
    head_gradient = jnp.zeros((shots, heads), block_information.dtype)
    head_gradient = head_gradient.at[shot[:, None], columns].add(gradient[:, :size])
    coupling, block, board_gradient = sum_boards(state, parametrization, table, *equations)
    inverse = jax.vmap(inverse_positive_definite)(block)
    determined = jnp.all(jnp.isfinite(inverse), axis=(1, 2))
    inverse = jnp.where(determined[:, None, None], inverse, 0.0)
    board_by_parameters = -jnp.einsum("spq,shq->sph", inverse, coupling)
    return (
        head + jnp.einsum("shp,spg->shg", coupling, board_by_parameters),
        head_gradient + jnp.einsum("sph,sp->sh", board_by_parameters, board_gradient),
        board_by_parameters,
        inverse,
        jnp.asarray(evaluate_prior(state, parametrization).information),
    )


class WhitenedViews(NamedTuple):
    """Whitened residuals of all observations and their Jacobian, as dense arrays.

    Attributes
    ----------
    jacobian : (v, 2n, h) derivative of the residuals of v observations of n points with respect to
        all h parameters that the shots share (lenses, cameras, board shape), fixed ones included.
    residual : (v, 2n) predicted minus observed pixel coordinates, in sigmas.
    """

    jacobian: Float[np.ndarray, "v m h"]
    residual: Float[np.ndarray, "v m"]


def whiten_views(problem: Problem) -> WhitenedViews:
    """Compute whitened residuals and their dense Jacobian. The Jacobian is large, so only for
    problems of few observations.
    """
    columns, jacobian, residual = (
        np.asarray(part)[: len(problem.views)]
        for part in _whiten_views(problem.state, problem.parametrization, problem.table)
    )
    dense = np.zeros((*jacobian.shape[:2], len(problem.free)))
    for k, view_columns in enumerate(columns):
        dense[k][:, view_columns] = jacobian[k]
    return WhitenedViews(dense, residual)


@partial(kept_jit, optimized_from=1 << 20)
def _whiten_views(
    state: RigState, parametrization: Parametrization, table: ObservationTable
) -> tuple[Array, Array, Array]:
    linearised = jax.vmap(lambda view: linearise(state, parametrization, view))(table)
    views, points, _, _ = linearised.jacobian.shape
    by_points = jax.vmap(lambda one: one.by_all_points)(linearised)
    jacobian = jnp.concatenate([linearised.jacobian[..., :-POSE_SIZE], by_points], axis=-1)
    jacobian = jacobian.reshape(views, 2 * points, -1)
    return linearised.columns, jacobian, linearised.residual.reshape(views, 2 * points)
