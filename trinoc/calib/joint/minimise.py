"""Levenberg and Marquardt's method on the reduced system of cameras and lines.

Written here because the solvers at hand take a residual and a Jacobian, and the point of the
reduced system is never to form them: 10,000 lines are 40,000 unknowns, of which 18 stay.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.calib.joint.camera_state import CameraState
from trinoc.calib.joint.line_chart import moved_anchors
from trinoc.calib.joint.reduced_system import (
    ReducedSystem,
    Tracks,
    reduce,
    robust_cost,
    track_blocks,
)
from trinoc.calib.joint.sheet_prior import SheetPrior
from trinoc.geometry.arrays import ArrayLike, ScalarLike

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e8
MOST_STEPS = 300
# The cost is a chi-square: a gain this small moves no parameter by some hundredths of its sigma.
CONVERGED_GAIN = 1e-4


class JointState(NamedTuple):
    """Where the minimisation stands."""

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]
    cost: Float[ArrayLike, ""]
    damping: Float[ArrayLike, ""]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


def joint_cost(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: Tracks,
    prior: SheetPrior,
    scale: ScalarLike,
) -> Float[ArrayLike, ""]:
    """Robust chi-square of the fragments plus that of the sheet."""
    return robust_cost(cameras, anchors_mm, tracks, scale) + prior.cost(cameras)


def joint_system(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: Tracks,
    prior: SheetPrior,
    scale: ScalarLike,
    damping: ScalarLike,
) -> ReducedSystem:
    """The reduced normal equations, with the sheet's part."""
    blocks = jax.vmap(track_blocks, (None, 0, 0, None))(cameras, anchors_mm, tracks, scale)
    system = reduce(blocks, tracks.seen, damping)
    information, gradient = prior.normal_equations(cameras)
    return system._replace(
        information=system.information + information, gradient=system.gradient + gradient
    )


@eqx.filter_jit
def minimise(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: Tracks,
    prior: SheetPrior,
    scale: ScalarLike,
) -> JointState:
    """Cameras and lines of least cost near the start; `converged` says whether it was reached.

    Directions that nothing determines (the gauge of a rig without a sheet) keep their start.
    """
    views = prior.values.shape[0]

    def attempt(state: JointState) -> JointState:
        system = joint_system(state.cameras, state.anchors_mm, tracks, prior, scale, state.damping)
        # Scaled to a unit diagonal; the floor keeps free directions at rest, and no more.
        diagonal = jnp.sqrt(jnp.maximum(jnp.diag(system.information), 1e-300))
        scaled = system.information / diagonal[:, None] / diagonal[None, :]
        damped = scaled + (state.damping + 1e-13) * jnp.eye(len(diagonal))
        step = -jnp.linalg.solve(damped, system.gradient / diagonal) / diagonal
        cameras = jax.vmap(CameraState.moved)(state.cameras, step.reshape(views, -1))
        offsets = system.line_step + jnp.einsum("tik,k->ti", system.line_by_cameras, step)
        anchors = jax.vmap(moved_anchors)(state.anchors_mm, offsets)
        cost = joint_cost(cameras, anchors, tracks, prior, scale)
        better = cost <= state.cost
        damping = jnp.where(better, state.damping / 10, state.damping * 10)
        done = jnp.where(better, state.cost - cost < CONVERGED_GAIN, damping > MOST_DAMPING)
        moved = JointState(
            cameras,
            anchors,
            cost,
            jnp.maximum(damping, LEAST_DAMPING),
            state.steps + 1,
            done & jnp.isfinite(cost),
        )
        kept = state._replace(damping=damping, steps=state.steps + 1, converged=done)
        return jax.tree.map(lambda new, old: jnp.where(better, new, old), moved, kept)

    start = JointState(
        cameras,
        jnp.asarray(anchors_mm),
        joint_cost(cameras, anchors_mm, tracks, prior, scale),
        jnp.asarray(FIRST_DAMPING),
        jnp.asarray(0),
        jnp.asarray(False),
    )
    return jax.lax.while_loop(
        lambda state: ~state.converged & (state.steps < MOST_STEPS), attempt, start
    )
