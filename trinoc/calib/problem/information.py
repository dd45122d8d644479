"""What each shot says of lenses, cameras and board, at the end of a fit."""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from trinoc.calib.problem.equations import sum_boards
from trinoc.calib.problem.places import linearise
from trinoc.calib.problem.problem import Problem
from trinoc.calib.problem.variables import POSE_SIZE, Parametrization, RigState, evaluate_prior
from trinoc.calib.problem.views import ViewTable
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.numerics.information import Observability, observability
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure
from trinoc.numerics.small_matrices import inverse_positive_definite


class Information(NamedTuple):
    """What each shot says of the head, its board eliminated, at the end of a fit.

    Fields
    ------
    of_shot : (s, h, h) information of each shot, without what was known beforehand.
    pulls : (s, h) gradient of half of each shot's chi-square; with the prior's they cancel.
    follow : (s, 6, h) how each board follows the head.
    own : (s, 6, 6) covariance of each board, the head given.
    free : (f,) columns of the head that were fitted.
    prior : (f, f) information that was known of lenses and board beforehand.
    shape_first : where, in the head, the steps of the board's places begin.
    tuning : constants of the problem that was fitted.
    """

    of_shot: Float[np.ndarray, "s h h"]
    pulls: Float[np.ndarray, "s h"]
    follow: Float[np.ndarray, "s 6 h"]
    own: Float[np.ndarray, "s 6 6"]
    free: np.ndarray
    prior: Float[np.ndarray, "f f"]
    shape_first: int
    tuning: CalibTuning = TUNING

    @property
    def observability(self) -> Observability:
        """What is determined of the free steps of the head."""
        return self.observability_of(np.ones(len(self.free), dtype=bool))

    def observability_of(self, rows: Bool[np.ndarray, "f"]) -> Observability:
        """What is determined of some of the free steps, the others held."""
        free = self.free[rows]
        kept = self.of_shot.sum(axis=0)[np.ix_(free, free)] + self.prior[np.ix_(rows, rows)]
        count = len(free)
        return observability(0.5 * (kept + kept.T), np.eye(count), np.full(count, np.inf))

    def of_steps(self, rows: Bool[np.ndarray, "f"]) -> "Information":
        """The same with some of the free steps alone, the others held."""
        prior = self.prior[np.ix_(rows, rows)]
        return self._replace(free=self.free[rows], prior=prior)


def compute_information(problem: Problem) -> Information:
    """The information at a problem's state."""
    of_shot, pulls, follow, own, prior = (
        np.asarray(part)
        for part in _of_shots(problem.state, problem.parametrization, problem.table)
    )
    free = np.flatnonzero(problem.free)
    prior = prior[np.ix_(free, free)]
    first = problem.slices.places.start
    return Information(of_shot, pulls, follow, own, free, prior, first, problem.tuning)


@kept_jit
def _of_shots(
    state: RigState, parametrization: Parametrization, table: ViewTable
) -> tuple[Array, ...]:
    plain = GemanMcClure.from_scale(jnp.asarray(jnp.inf))

    def of_view(view: ViewTable) -> tuple[Array, Array, Array]:
        near = linearise(state, parametrization, view)
        return near.columns, *near.weigh(parametrization, plain)

    seen = jax.vmap(of_view)(table)
    columns, own, gradient = seen
    size, shots, heads = (
        columns.shape[1],
        state.rig_from_board.shape[0],
        parametrization.free.shape[0],
    )
    shot = jnp.asarray(table.shot)
    # From each step of the head to its column, the last one for what a view does not have: to look
    # numbers up is quicker than to scatter them.
    column = jax.vmap(lambda own: jnp.full(heads, size).at[own].set(jnp.arange(size)))(columns)
    padded = jnp.pad(own[:, :size, :size], ((0, 0), (0, 1), (0, 1)))
    of_views = jax.vmap(lambda own, at: own[at][:, at])(padded, column)
    head = jax.ops.segment_sum(of_views, shot, shots)
    of_head = jnp.zeros((shots, heads), own.dtype)
    of_head = of_head.at[shot[:, None], columns].add(gradient[:, :size])
    coupling, block, of_board = sum_boards(state, parametrization, table, *seen)
    inverse = jax.vmap(inverse_positive_definite)(block)
    determined = jnp.all(jnp.isfinite(inverse), axis=(1, 2))
    inverse = jnp.where(determined[:, None, None], inverse, 0.0)
    follow = -jnp.einsum("spq,shq->sph", inverse, coupling)
    return (
        head + jnp.einsum("shp,spg->shg", coupling, follow),
        of_head + jnp.einsum("sph,sp->sh", follow, of_board),
        follow,
        inverse,
        jnp.asarray(evaluate_prior(state, parametrization).information),
    )


class WhitenedViews(NamedTuple):
    """All views at a state, by every step of the head, those that are held too.

    Fields
    ------
    jacobian : (v, 2n, h) of the whitened residuals.
    residual : (v, 2n) predicted minus observed, in sigmas.
    """

    jacobian: Float[np.ndarray, "v m h"]
    residual: Float[np.ndarray, "v m"]


def whiten_views(problem: Problem) -> WhitenedViews:
    """Residuals of each view and their derivatives; dense, for problems of few views."""
    columns, jacobian, residual = (
        np.asarray(part)[: len(problem.views)]
        for part in _whiten_views(problem.state, problem.parametrization, problem.table)
    )
    dense = np.zeros((*jacobian.shape[:2], len(problem.free)))
    for k, own in enumerate(columns):
        dense[k][:, own] = jacobian[k]
    return WhitenedViews(dense, residual)


@partial(kept_jit, optimized_from=1 << 20)
def _whiten_views(
    state: RigState, parametrization: Parametrization, table: ViewTable
) -> tuple[Array, Array, Array]:
    near = jax.vmap(lambda view: linearise(state, parametrization, view))(table)
    views, places, _, _ = near.jacobian.shape
    by_places = jax.vmap(lambda one: one.by_all_places)(near)
    jacobian = jnp.concatenate([near.jacobian[..., :-POSE_SIZE], by_places], axis=-1)
    jacobian = jacobian.reshape(views, 2 * places, -1)
    return near.columns, jacobian, near.residual.reshape(views, 2 * places)
