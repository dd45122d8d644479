"""Where the unknowns of a picture explain it best: Gauss-Newton steps that optimistix drives.

A solver on the manifold of poses, in a chart laid anew at every point. First come robust steps,
one at each of several scales; then damped ones of least squares, each of which must pay.
"""

from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

from trinoc.calib.photometric.equations import Equations, Picture, build_equations
from trinoc.calib.photometric.ink import InkDrawing
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.geometry.pose import PoseModel
from trinoc.numerics.precision import ArrayLike
from trinoc.numerics.programs import kept_jit
from trinoc.numerics.robust_loss import GemanMcClure

# numerical: damping of steps.
_LEAST_DAMPING, _FIRST_DAMPING, _DAMPING_FACTOR, _ROBUST_DAMPING = 1e-6, 1e-3, 30.0, 1e-4
# numerical: where a step does not pay, shorter ones are tried: light and its local factor are a
# product.
_SHARES = (1.0, 0.3, 0.1)
_GROWTH, _SLACK = 1e-5, 0.1  # numerical: chi-square may grow by so much, of itself and beyond


class Stage(NamedTuple):
    """How one step looks at the picture.

    Fields
    ------
    loss : what a residual can cost, sigmas squared; infinity for plain least squares.
    free : (k,) 1 for each unknown that the step may change, else 0.
    stride : the step looks at the first of so many parts of each group's chunks only.
    """

    loss: GemanMcClure
    free: Float[ArrayLike, "*s k"]
    stride: Int[ArrayLike, "*s"]


class Schedule(NamedTuple):
    """The steps of a fit.

    Fields
    ------
    stages : of the robust steps, along a first axis, and last that of all further ones.
    robust_steps : how many robust steps are taken, whether they pay or not.
    most_steps : how many more may be.
    atol : the fit has converged where the next step would move the pose by less than this many of
        its standard deviations.
    """

    stages: Stage
    robust_steps: Int[ArrayLike, ""]
    most_steps: Int[ArrayLike, ""]
    atol: Float[ArrayLike, ""]


class Fit(NamedTuple):
    """Where the steps ended.

    Fields
    ------
    state : of all unknowns.
    equations : there, as plain least squares.
    length : of the step that would come next, of the pose in its own standard deviations.
    """

    state: PictureState
    equations: Equations
    length: Float[ArrayLike, ""]


class _Base(NamedTuple):
    """The best point so far, with all that a step from it takes."""

    state: PictureState
    matrix: Float[ArrayLike, "k k"]
    gradient: Float[ArrayLike, "k"]
    elimination: PyTree
    sigma: tuple[Float[ArrayLike, "c n"], Float[ArrayLike, "d n"]]
    cost: Float[ArrayLike, ""]


class _DescentState(eqx.Module):
    """Between two steps.

    Fields
    ------
    steps : taken and paid.
    refusals : of the present step.
    damping : of the next.
    base : what it starts from.
    length : of the next step, of the pose in its own standard deviations.
    done : whether the fit has ended.
    """

    steps: Int[ArrayLike, ""]
    refusals: Int[ArrayLike, ""]
    damping: Float[ArrayLike, ""]
    base: _Base
    length: Float[ArrayLike, ""]
    done: Bool[ArrayLike, ""]


class PictureSolver(optx.AbstractRootFinder[PictureState, Array, Equations, _DescentState]):
    """Finds where the gradient vanishes, with the matrix of the normal equations for its slope.

    As a root finder it never needs the residuals' Jacobian at once: it is summed over chunks.

    Fields
    ------
    schedule : of the steps, with the tolerance.
    model : what a step may change of the pose.
    """

    schedule: Schedule
    model: PoseModel = eqx.field(static=True)
    # optimistix wants these; `Schedule.atol` ends the steps.
    rtol: ClassVar[float] = 0.0
    atol: ClassVar[float] = 0.0
    norm: ClassVar[Callable[[PyTree], Scalar]] = staticmethod(optx.max_norm)

    def init(
        self,
        fn: Any,
        y: PictureState,
        args: tuple[Picture, Stage],
        options: dict[str, Any],
        f_struct: PyTree,
        aux_struct: Equations,
        tags: frozenset[object],
    ) -> _DescentState:
        """No step taken."""
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct)
        none, far = jnp.asarray(0), jnp.asarray(jnp.inf)
        damping = jnp.asarray(_LEAST_DAMPING)
        return _DescentState(none, none, damping, _base(y, empty), far, jnp.asarray(False))

    def step(
        self,
        fn: Any,
        y: PictureState,
        args: tuple[Picture, Stage],
        options: dict[str, Any],
        state: _DescentState,
        tags: frozenset[object],
    ) -> tuple[PictureState, _DescentState, Equations]:
        """Look at `y`, and step from it, or where it does not pay once more from before."""
        schedule, last = self.schedule, len(self.schedule.stages.stride) - 1
        is_robust = state.steps < schedule.robust_steps
        turn = jnp.where(is_robust, state.steps, last)
        stage = jax.tree.map(lambda leaf: leaf[turn], schedule.stages)
        _, equations = fn(y, (args[0], stage))
        is_first = state.steps <= schedule.robust_steps
        returned = state.refusals >= len(_SHARES)
        before = _cost(args[0], equations, state.base.sigma)
        pays = is_first | returned | (before <= state.base.cost * (1 + _GROWTH) + _SLACK)
        own = _base(y, equations)
        own = own._replace(cost=_cost(args[0], equations, own.sigma))
        base = jax.tree.map(lambda new, old: jnp.where(pays, new, old), own, state.base)
        refusals = jnp.where(pays, 0, state.refusals + 1)
        eased = jnp.maximum(state.damping / _DAMPING_FACTOR, _LEAST_DAMPING)
        raised = jnp.maximum(state.damping * _DAMPING_FACTOR, _FIRST_DAMPING)
        damping = jnp.where(pays, eased, raised)
        now = jnp.where(is_robust, _ROBUST_DAMPING, damping)
        motion, length = _damped_step(base, stage.free, now, self.model)
        short = ~is_robust & (length <= schedule.atol)
        exhausted = state.steps >= schedule.robust_steps + schedule.most_steps
        done = returned | (pays & (short | exhausted))
        share = jnp.asarray((*_SHARES, 0.0))[jnp.minimum(refusals, len(_SHARES))]
        levels = base.state.levels
        if base.elimination is not None:
            levels = levels + share * (base.elimination.levels_after(levels, motion) - levels)
        after = base.state.move(share * motion, levels, self.model)
        after = jax.tree.map(lambda stay, go: jnp.where(done, stay, go), y, after)
        steps = jnp.where(pays & ~done, state.steps + 1, state.steps)
        return after, _DescentState(steps, refusals, damping, base, length, done), equations

    def terminate(
        self,
        fn: Any,
        y: PictureState,
        args: tuple[Picture, Stage],
        options: dict[str, Any],
        state: _DescentState,
        tags: frozenset[object],
    ) -> tuple[Bool[ArrayLike, ""], optx.RESULTS]:
        """At a point that was looked at."""
        return state.done, optx.RESULTS.successful

    def postprocess(
        self,
        fn: Any,
        y: PictureState,
        aux: Equations,
        args: tuple[Picture, Stage],
        options: dict[str, Any],
        state: _DescentState,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[PictureState, Equations, dict[str, Any]]:
        """The point as it is."""
        return y, aux, {}


def fit_picture(
    state: PictureState,
    picture: Picture,
    schedule: Schedule,
    *,
    drawing: InkDrawing,
    model: PoseModel,
) -> Fit:
    """Steps from `state` until they end; differentiating them raises."""

    def gradient(state: PictureState, args: tuple[Picture, Stage]) -> tuple[ArrayLike, Equations]:
        picture, stage = args
        equations = build_equations(state, picture, stage.loss, stage.stride, drawing, model)
        return equations.gradient, equations

    first = jax.tree.map(lambda leaf: leaf[0], schedule.stages)
    solution = optx.root_find(
        gradient,
        PictureSolver(schedule=schedule, model=model),
        state,
        args=(picture, first),
        has_aux=True,
        max_steps=None,
        adjoint=optx.ImplicitAdjoint(lx.LU()),
        throw=False,
    )
    return Fit(solution.value, solution.aux, solution.state.length)


def _base(state: PictureState, equations: Equations) -> _Base:
    return _Base(
        state,
        equations.matrix,
        equations.gradient,
        equations.elimination,
        (equations.pixels[0].sigma, equations.pixels[1].sigma),
        equations.prior_cost,
    )


def _cost(
    picture: Picture,
    equations: Equations,
    sigma: tuple[Float[ArrayLike, "c n"], Float[ArrayLike, "d n"]],
) -> Float[ArrayLike, ""]:
    """Chi-square with priors, of residuals over given standard deviations; those of pixels that
    were not looked at are zero."""
    total = equations.prior_cost
    groups = (picture.near_circles, picture.near_lines)
    for group, seen, own in zip(groups, equations.pixels, sigma, strict=True):
        weight = group.pixels.weight.reshape(seen.residual.shape)
        standard = weight * seen.residual / jnp.where(own > 0, own, 1.0)
        total = total + jnp.sum((standard**2).astype(total.dtype))
    return total


def _damped_step(
    base: _Base, free: Float[ArrayLike, "k"], damping: Float[ArrayLike, ""], model: PoseModel
) -> tuple[Float[ArrayLike, "k"], Float[ArrayLike, ""]]:
    """Gauss-Newton step on the free unknowns, with columns scaled alike, and by how many of its
    own standard deviations it moves the pose."""
    matrix = base.matrix * free[:, None] * free[None] + jnp.diag(1 - free)
    scale = jnp.sqrt(jnp.maximum(jnp.diag(matrix), 1e-300))
    scaled = matrix / (scale[:, None] * scale[None]) + damping * jnp.eye(len(scale))
    factor = jax.scipy.linalg.cho_factor(scaled)
    size = model.size
    sides = jnp.column_stack([free * base.gradient / scale, jnp.eye(len(scale), size)])
    solved = jax.scipy.linalg.cho_solve(factor, sides)
    motion = -solved[:, 0] / scale
    covariance = solved[:size, 1:] / (scale[:size, None] * scale[None, :size])
    length = jnp.sqrt(jnp.abs(motion[:size] @ jnp.linalg.solve(covariance, motion[:size])))
    return motion, length


run_fit = kept_jit(fit_picture, static_argnames=("drawing", "model"))
