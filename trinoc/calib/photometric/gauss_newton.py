"""Robust Gauss-Newton over the pose and the appearance of one picture.

A solver of optimistix' kind that steps on the manifold of poses, in a chart laid anew at every
point.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int, PyTree, Scalar

from trinoc.calib.photometric.appearance import NUISANCE, Appearance, Pixels
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.normal_equations import normal_equations
from trinoc.geometry import Pose, PoseModel
from trinoc.numerics import ArrayLike, GemanMcClure, ScalarLike, inverse_3x3, kept_jit

MOST_STEPS = 8


class Group(NamedTuple):
    """Pixels that share a model: those near circles only, or those near a line too."""

    pixels: Pixels
    chunks: Int[ArrayLike, ""]


class ImageState(NamedTuple):
    """Everything that is unknown about one picture."""

    pose: Pose
    appearance: Appearance


class Stage(NamedTuple):
    """How one step looks at the picture.

    Fields
    ------
    loss : what a residual can cost, grey levels squared; infinity for plain least squares.
    held : (k,) 1 for each unknown that the step leaves as it is, else 0.
    stride : the step looks at the first of so many parts of each group's chunks only.
    """

    loss: GemanMcClure
    held: Float[ArrayLike, "*s k"]
    stride: Int[ArrayLike, "*s"]


class Picture(NamedTuple):
    """What one picture of the sheet shows, and how steps look at it."""

    near_circles: Group
    near_lines: Group
    cross: Cross
    stage: Stage


class Sums(NamedTuple):
    """What is summed over the pixels at one point, beside the gradient.

    Fields
    ------
    information : (k, k) J^T W J of (pose chart, appearance), in 1 / grey level^2.
    residuals : of both groups, grey levels, padding included.
    columns : of both groups, see `NormalEquations`.
    pose : at which all this is.
    """

    information: Float[ArrayLike, "k k"]
    residuals: tuple[Float[ArrayLike, "n"], Float[ArrayLike, "m"]]
    columns: tuple[Float[ArrayLike, "12 n"], Float[ArrayLike, "12 m"]]
    pose: Pose


class Fit(NamedTuple):
    """Where the steps ended.

    Fields
    ------
    state : after the last step.
    sums : at the point that the last step was taken from.
    converged : whether the last step was short enough.
    """

    state: ImageState
    sums: Sums
    converged: Bool[ArrayLike, ""]


def gradient_and_sums(
    state: ImageState, image: Picture, drawing: Drawing, model: PoseModel
) -> tuple[Float[ArrayLike, "k"], Sums]:
    """J^T W r by the chart of the pose and the appearance, which a fit brings to zero."""
    zero = jnp.zeros(model.size, state.pose.rotation.dtype)

    def retracted(motion: Float[ArrayLike, "p"]) -> Pose:
        return state.pose.retract(motion, model, step_unit_mm(state.pose, model))

    def homography_after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        return sheet_from_camera(retracted(motion)).reshape(9)

    homography, by_motion = homography_after(zero), jax.jacfwd(homography_after)(zero)
    sums = [
        normal_equations(
            homography.reshape(3, 3),
            state.appearance,
            group.pixels,
            -(-group.chunks // image.stage.stride),
            image.cross,
            image.stage.loss,
            drawing,
            near_line,
        )
        for group, near_line in ((image.near_circles, False), (image.near_lines, True))
    ]
    matrix = sums[0].matrix + sums[1].matrix
    slope = sums[0].gradient + sums[1].gradient
    chain = jnp.zeros((9 + NUISANCE, model.size + NUISANCE), zero.dtype)
    chain = chain.at[:9, : model.size].set(by_motion)
    chain = chain.at[9:, model.size :].set(jnp.eye(NUISANCE, dtype=zero.dtype))
    residuals = (sums[0].residuals, sums[1].residuals)
    columns = (sums[0].columns, sums[1].columns)
    return chain.T @ slope, Sums(chain.T @ matrix @ chain, residuals, columns, state.pose)


class _State(eqx.Module):
    """Steps taken, and the length of the last in its own standard deviations."""

    steps: Int[ArrayLike, ""]
    length: Float[ArrayLike, ""]


class StagedGaussNewton(optx.AbstractRootFinder[ImageState, Array, Sums, _State]):
    """Finds where `gradient_and_sums` has no gradient, with J^T W J for its derivative.

    As a root finder it never needs the residuals at once, nor their Jacobian: both are summed
    over chunks of pixels.

    Fields
    ------
    stages : of the first steps, along a first axis; the last serves all further steps.
    round_steps : convergence is looked at after each so many steps.
    model : what a step may change of the pose.
    atol : the length of a step that ends the fit, in units of its own standard deviation for
        noise of one grey level.
    rtol, norm : not used.
    """

    stages: Stage
    round_steps: Int[ArrayLike, ""]
    model: PoseModel = eqx.field(static=True)
    atol: ScalarLike
    rtol: float = 0.0
    norm: Callable[[PyTree], Scalar] = eqx.field(default=optx.max_norm, static=True)

    def init(
        self,
        fn: Any,
        y: ImageState,
        args: Picture,
        options: dict[str, Any],
        f_struct: PyTree,
        aux_struct: PyTree,
        tags: frozenset[object],
    ) -> _State:
        """No step taken."""
        return _State(jnp.asarray(0), jnp.full((), jnp.inf, y.pose.rotation.dtype))

    def step(
        self,
        fn: Any,
        y: ImageState,
        args: Picture,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
    ) -> tuple[ImageState, _State, Sums]:
        """One step of the stage whose turn it is."""
        turn = jnp.minimum(state.steps, len(self.stages.stride) - 1)
        stage = jax.tree.map(lambda leaf: leaf[turn], self.stages)
        gradient, sums = fn(y, args._replace(stage=stage))
        motion = -_solve(sums.information, gradient, stage.held)
        count = self.model.size
        after = ImageState(
            y.pose.retract(motion[:count], self.model, step_unit_mm(y.pose, self.model)),
            _kept_possible(y.appearance.vector + motion[count:]),
        )
        return after, _State(state.steps + 1, jnp.sqrt(-motion @ gradient)), sums

    def terminate(
        self,
        fn: Any,
        y: ImageState,
        args: Picture,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
    ) -> tuple[Bool[Array, ""], optx.RESULTS]:
        """Converged at the end of a round."""
        done = (state.steps % self.round_steps == 0) & (state.length <= self.atol)
        return jnp.asarray((state.steps > 0) & done), optx.RESULTS.successful

    def postprocess(
        self,
        fn: Any,
        y: ImageState,
        aux: Sums,
        args: Picture,
        options: dict[str, Any],
        state: _State,
        tags: frozenset[object],
        result: optx.RESULTS,
    ) -> tuple[ImageState, Sums, dict[str, Any]]:
        """The point as it is."""
        return y, aux, {}


def fit_picture(
    state: ImageState,
    near_circles: Group,
    near_lines: Group,
    cross: Cross,
    solver: StagedGaussNewton,
    *,
    drawing: Drawing,
    model: PoseModel,
) -> Fit:
    """Steps from `state` until the solver has converged or taken `MOST_STEPS`.

    Differentiating it raises, because a state has more numbers than freedoms:
    `implicit.fitted` gives derivatives.
    """
    first = jax.tree.map(lambda leaf: leaf[0], solver.stages)
    solution = optx.root_find(
        partial(gradient_and_sums, drawing=drawing, model=model),
        solver,
        state,
        args=Picture(near_circles, near_lines, cross, first),
        has_aux=True,
        max_steps=MOST_STEPS,
        adjoint=optx.ImplicitAdjoint(lx.LU()),
        throw=False,
    )
    return Fit(solution.value, solution.aux, solution.result == optx.RESULTS.successful)


def sheet_from_camera(pose: Pose) -> Float[ArrayLike, "3 3"]:
    """Homography from directions in the camera to the sheet.

    Its last row is of unit length: a sheet may lie anywhere about the camera.
    """
    inverse = inverse_3x3(pose.cam_from_sheet)
    return inverse / jnp.sqrt(inverse[2] @ inverse[2])


def step_unit_mm(pose: Pose, model: PoseModel) -> Float[ArrayLike, ""]:
    """The unit of lengths in steps of a pose: its distance along the axis, or from the sheet's
    middle where the axis need not meet the sheet."""
    if model is PoseModel.RIGID:
        return jnp.sqrt(pose.translation_mm @ pose.translation_mm)
    return pose.distance_mm


def _solve(
    information: Float[ArrayLike, "k k"],
    gradient: Float[ArrayLike, "k"],
    held: Float[ArrayLike, "k"],
) -> Float[ArrayLike, "k"]:
    """Gauss-Newton step on the unknowns that are not held, with columns scaled alike."""
    free = 1 - held
    matrix = information * free[:, None] * free[None] + jnp.diag(held)
    scale = jnp.sqrt(jnp.diag(matrix))
    scale = jnp.where(scale == 0, jnp.ones_like(scale), scale)
    operator = lx.MatrixLinearOperator(
        jnp.asarray(matrix / (scale[:, None] * scale[None])), lx.positive_semidefinite_tag
    )
    side = free * gradient / scale
    return lx.linear_solve(operator, side, lx.Cholesky(), throw=False).value / scale


def _kept_possible(vector: Float[ArrayLike, "9"]) -> Appearance:
    """The appearance, with the blur kept from falling below a third of the pixel's own."""
    appearance = Appearance.from_vector(vector)
    return appearance._replace(sigma_px=jnp.maximum(appearance.sigma_px, 0.1))


run_fit = kept_jit(fit_picture, static_argnames=("drawing", "model"))
