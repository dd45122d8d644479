"""Levenberg and Marquardt's method on the normal equations of cameras and lines.

A solver of optimistix' kind, which never forms the Jacobian: 10,000 lines are 40,000 unknowns,
of which 18 stay once each line is eliminated (`numerics.block_arrow`). It steps on the manifold
of cameras and lines, whose charts are laid anew at every point, so it moves points and not
vectors.

Every line has a damping of its own, and stays where it was when that serves it better: among
thousands some lie nearly in an epipolar plane, and the one that strays most would otherwise hold
back all others.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree

from trinoc.calib.bundle.line_retraction import moved_anchors
from trinoc.calib.bundle.pose_prior import PosePrior
from trinoc.calib.bundle.schur import (
    FragmentTable,
    NormalEquations,
    normal_equations,
    robust_costs,
    track_blocks,
)
from trinoc.calib.bundle.two_view_lines import placed_by_two_views
from trinoc.calib.model import CameraState
from trinoc.numerics import (
    AbstractManifoldMinimiser,
    AbstractRobustLoss,
    ArrayLike,
    BlockArrowSolver,
    DampedDescent,
    ScalarLike,
)

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-4, 1e-12, 1e8
# Keeps directions that nothing determines at rest, and no more.
FLOOR_DAMPING = 1e-13
MOST_STEPS = 300
# The gain at which a fit has converged is asked of the cameras' own share, and of every hundred
# lines together, a few of which always creep along the flank of the robust loss.
LINES_THAT_CREEP = 100


class JointState(NamedTuple):
    """Where the minimisation ended, after how many steps, and whether it converged."""

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]
    cost: Float[ArrayLike, ""]
    steps: Int[ArrayLike, ""]
    converged: Bool[ArrayLike, ""]


class Point(NamedTuple):
    """Cameras and lines, by two anchor points on each."""

    cameras: CameraState
    anchors_mm: Float[ArrayLike, "t 2 3"]

    def retract(self, step: tuple[Float[ArrayLike, "k"], Float[ArrayLike, "t 4"]]) -> "Point":
        """The point after a step in the charts laid here."""
        views = self.cameras.reach_mm.shape[0]
        cameras = jax.vmap(CameraState.retract)(self.cameras, step[0].reshape(views, -1))
        return Point(cameras, jax.vmap(moved_anchors)(self.anchors_mm, step[1]))


class Observations(NamedTuple):
    """What cameras and lines are held against: tracks, the sheet's word, and the loss."""

    tracks: FragmentTable
    prior: PosePrior
    loss: AbstractRobustLoss


class Costs(NamedTuple):
    """Robust chi-square of each track's fragments, and chi-square of the sheet."""

    tracks: Float[ArrayLike, "t"]
    sheet: Float[ArrayLike, ""]


def joint_costs(point: Point, observations: Observations) -> tuple[Float[Array, ""], Costs]:
    """The joint cost, and its parts."""
    tracks, prior, loss = observations
    costs = Costs(robust_costs(*point, tracks, loss), prior.cost(point.cameras))
    return jnp.sum(costs.tracks) + costs.sheet, costs


def joint_cost(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    loss: AbstractRobustLoss,
) -> Float[ArrayLike, ""]:
    """Robust chi-square of the fragments plus that of the sheet."""
    return joint_costs(Point(cameras, anchors_mm), Observations(tracks, prior, loss))[0]


def joint_system(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    loss: AbstractRobustLoss,
    damping: ScalarLike | Float[ArrayLike, "t"],
) -> NormalEquations:
    """The normal equations of all tracks, with the sheet's part."""
    blocks = jax.vmap(track_blocks, (None, 0, 0, None))(cameras, anchors_mm, tracks, loss)
    arrow, (of_cameras, of_lines) = normal_equations(blocks, tracks.seen, damping)
    information, gradient = prior.normal_equations(cameras)
    return NormalEquations(
        eqx.tree_at(lambda arrow: arrow.head, arrow, arrow.head + information),
        (of_cameras + gradient, of_lines),
    )


class _State(DampedDescent):
    line_damping: Float[ArrayLike, "t"]


class JointLevenbergMarquardt(AbstractManifoldMinimiser[Point, Costs, _State]):
    """Minimises `joint_costs` over a `Point`, given `Observations`; `atol` is for the gain of the
    cameras, and for that of lines that creep."""

    def init(
        self,
        fn: Any,
        y: Point,
        args: Observations,
        options: dict[str, Any],
        f_struct: PyTree,
        aux_struct: PyTree,
        tags: frozenset[object],
    ) -> _State:
        """Nothing tried yet."""
        return _State(
            fn(y, args)[0],
            jnp.asarray(FIRST_DAMPING),
            jnp.asarray(False),
            jnp.full(y.anchors_mm.shape[0], FIRST_DAMPING),
        )

    def step(
        self,
        fn: Any,
        y: Point,
        args: Observations,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
    ) -> tuple[Point, _State, Costs]:
        """Try one step, and take it where it gains."""
        system = joint_system(*y, *args, state.line_damping)
        solver = BlockArrowSolver(state.damping + FLOOR_DAMPING)
        factored = solver.init(system.information, {})
        solution = lx.linear_solve(
            system.information, system.gradient, solver, state=factored, throw=False
        )
        step = jax.tree.map(jnp.negative, solution.value)
        followed = y.retract(step)
        moved = fn(followed, args)[1]
        stayed = fn(followed._replace(anchors_mm=y.anchors_mm), args)[1]
        follows = moved.tracks <= stayed.tracks
        tried = followed._replace(
            anchors_mm=jnp.where(follows[:, None, None], followed.anchors_mm, y.anchors_mm)
        )
        costs = moved._replace(tracks=jnp.where(follows, moved.tracks, stayed.tracks))
        cost = jnp.sum(costs.tracks) + costs.sheet
        better = cost <= state.cost
        damping = jnp.where(better, state.damping / 10, state.damping * 10)
        speaking = jnp.sum(jnp.sum(args.tracks.seen, axis=1) >= 3)
        negligible = self.atol * (1 + speaking / LINES_THAT_CREEP)
        gain_of_cameras = -factored.elimination.reduced_side(system.gradient) @ step[0]
        still = (gain_of_cameras < self.atol) & (state.cost - cost < negligible)
        line_damping = state.line_damping * jnp.where(follows & better, 0.1, 10.0)
        after = _State(
            jnp.where(better, cost, state.cost),
            jnp.maximum(damping, LEAST_DAMPING),
            jnp.where(better, still, damping > MOST_DAMPING),
            jnp.clip(line_damping, LEAST_DAMPING, MOST_DAMPING),
        )
        return jax.tree.map(lambda new, old: jnp.where(better, new, old), tried, y), after, costs


@eqx.filter_jit
def minimise(
    cameras: CameraState,
    anchors_mm: Float[ArrayLike, "t 2 3"],
    tracks: FragmentTable,
    prior: PosePrior,
    loss: AbstractRobustLoss,
) -> JointState:
    """Cameras and lines of least cost near the start; `converged` says whether it was reached.

    Directions that nothing determines (the gauge of a rig without a sheet) keep their start.
    Differentiating it raises: a point has more numbers than freedoms. `implicit_diff.refined` gives
    derivatives.
    """
    # Two views of a line always agree: they wait until the cameras stand.
    speaks = jnp.sum(tracks.seen, axis=1) >= 3
    speaking = tracks._replace(seen=tracks.seen & speaks[:, None])
    solution = optx.minimise(
        joint_costs,
        JointLevenbergMarquardt(),
        Point(cameras, jnp.asarray(anchors_mm)),
        Observations(speaking, prior, loss),
        has_aux=True,
        max_steps=MOST_STEPS,
        adjoint=optx.ImplicitAdjoint(BlockArrowSolver()),
        throw=False,
    )
    end = solution.value
    return JointState(
        end.cameras,
        placed_by_two_views(*end, tracks),
        solution.stats["cost"],
        solution.stats["num_steps"],
        solution.result == optx.RESULTS.successful,
    )
