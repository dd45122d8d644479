"""Levenberg and Marquardt's method on the reduced system of cameras and lines.

Written here because the solvers at hand take a residual and a Jacobian, and the point of the
reduced system is never to form them: 10,000 lines are 40,000 unknowns, of which 18 stay.

Every line has a damping of its own, and stays where it was when that serves it better: among
thousands some lie nearly in an epipolar plane, and the one that strays most would otherwise hold
back all others.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Bool, Float, Int

from trinoc.calib.bundle.line_retraction import moved_anchors
from trinoc.calib.bundle.pose_prior import PosePrior
from trinoc.calib.bundle.schur import (
    FragmentTable,
    ReducedSystem,
    reduce,
    robust_costs,
    track_blocks,
)
from trinoc.calib.bundle.two_view_lines import placed_by_two_views
from trinoc.calib.model import CameraState
from trinoc.numerics import ArrayLike, ScalarLike

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e8
MOST_STEPS = 300
# The cost is a chi-square: a gain this small moves no parameter by some hundredths of its sigma.
# It is asked of the cameras' own share, and of every hundred lines together, a few of which
# always creep along the flank of the robust loss.
CONVERGED_GAIN = 1e-4


class JointState(NamedTuple):
    """Where the minimisation stands."""

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]
    cost: Float[ArrayLike, ""]
    damping: Float[ArrayLike, ""]
    line_damping: Float[ArrayLike, "t"]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


def joint_cost(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    scale: ScalarLike,
) -> Float[ArrayLike, ""]:
    """Robust chi-square of the fragments plus that of the sheet."""
    return jnp.sum(robust_costs(cameras, anchors_mm, tracks, scale)) + prior.cost(cameras)


def joint_system(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    scale: ScalarLike,
    damping: ScalarLike | Float[ArrayLike, "t"],
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
    tracks: FragmentTable,
    prior: PosePrior,
    scale: ScalarLike,
) -> JointState:
    """Cameras and lines of least cost near the start; `converged` says whether it was reached.

    Directions that nothing determines (the gauge of a rig without a sheet) keep their start.
    """
    views = prior.values.shape[0]
    # Two views of a line always agree: they wait until the cameras stand.
    speaks = jnp.sum(tracks.seen, axis=1) >= 3
    speaking = tracks._replace(seen=tracks.seen & speaks[:, None])
    negligible = CONVERGED_GAIN * (1 + jnp.sum(speaks) / 100)

    def attempt(state: JointState) -> JointState:
        system = joint_system(
            state.cameras, state.anchors_mm, speaking, prior, scale, state.line_damping
        )
        # Scaled to a unit diagonal; the floor keeps free directions at rest, and no more.
        diagonal = jnp.sqrt(jnp.maximum(jnp.diag(system.information), 1e-300))
        scaled = system.information / diagonal[:, None] / diagonal[None, :]
        damped = scaled + (state.damping + 1e-13) * jnp.eye(len(diagonal))
        step = -jnp.linalg.solve(damped, system.gradient / diagonal) / diagonal
        cameras = jax.vmap(CameraState.moved)(state.cameras, step.reshape(views, -1))
        offsets = system.line_step + jnp.einsum("tik,k->ti", system.line_by_cameras, step)
        followed = jax.vmap(moved_anchors)(state.anchors_mm, offsets)
        moved, stayed = (
            robust_costs(cameras, anchors, speaking, scale)
            for anchors in (followed, state.anchors_mm)
        )
        follows = moved <= stayed
        anchors = jnp.where(follows[:, None, None], followed, state.anchors_mm)
        cost = jnp.sum(jnp.where(follows, moved, stayed)) + prior.cost(cameras)
        better = cost <= state.cost
        damping = jnp.where(better, state.damping / 10, state.damping * 10)
        still = (-system.gradient @ step < CONVERGED_GAIN) & (state.cost - cost < negligible)
        done = jnp.where(better, still, damping > MOST_DAMPING)
        line_damping = state.line_damping * jnp.where(follows & better, 0.1, 10.0)
        return JointState(
            jax.tree.map(lambda new, old: jnp.where(better, new, old), cameras, state.cameras),
            jnp.where(better, anchors, state.anchors_mm),
            jnp.where(better, cost, state.cost),
            jnp.maximum(damping, LEAST_DAMPING),
            jnp.clip(line_damping, LEAST_DAMPING, MOST_DAMPING),
            state.steps + 1,
            done & jnp.isfinite(state.cost),
        )

    start = JointState(
        cameras,
        jnp.asarray(anchors_mm),
        joint_cost(cameras, anchors_mm, speaking, prior, scale),
        jnp.asarray(FIRST_DAMPING),
        jnp.full(tracks.seen.shape[0], FIRST_DAMPING),
        jnp.asarray(0),
        jnp.asarray(False),
    )
    end = jax.lax.while_loop(
        lambda state: ~state.converged & (state.steps < MOST_STEPS), attempt, start
    )
    return end._replace(anchors_mm=placed_by_two_views(end.cameras, end.anchors_mm, tracks))
