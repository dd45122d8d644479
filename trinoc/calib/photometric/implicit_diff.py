"""The fitted pose and appearance as a differentiable function of what the pixels hold.

The fit ends where J^T r, summed over the pixels, vanishes. By the implicit function theorem its
answer follows the grey levels, the rays (and with them the lens), the circles and the cross,
without differentiating the steps that led there. J is held where it stands, as in Gauss-Newton:
what its own change adds is weighted by residuals, which are noise of no sign.
"""

from functools import partial

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Float

from trinoc.calib.photometric.appearance import NUISANCE, Appearance, predict
from trinoc.calib.photometric.gauss_newton import (
    Group,
    ImageState,
    sheet_from_camera,
    step_unit_mm,
)
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.geometry import PoseModel
from trinoc.numerics import ArrayLike


def fitted(
    state: ImageState,
    near_circles: Group,
    near_lines: Group,
    cross: Cross,
    *,
    drawing: Drawing,
    model: PoseModel,
) -> ImageState:
    """`state`, where a fit without a robust loss ended, with its derivatives by all the rest.

    Those by `state` itself are zero. Pixels are in double precision. For use under `jit`, `jvp`
    and `grad`.
    """
    state = jax.lax.stop_gradient(state)
    solution = optx.root_find(
        partial(_gradient_after, drawing=drawing, model=model),
        optx.Newton(0.0, 0.0),
        jnp.zeros(model.size + NUISANCE),
        args=(state, near_circles, near_lines, cross),
        adjoint=optx.ImplicitAdjoint(lx.LU()),
        # None: the fit has been made.
        max_steps=0,
        throw=False,
    )
    return _after(state, solution.value, model)


def _after(state: ImageState, step: Float[ArrayLike, "k"], model: PoseModel) -> ImageState:
    appearance = Appearance.from_vector(state.appearance.vector + step[model.size :])
    pose = state.pose.retract(step[: model.size], model, step_unit_mm(state.pose, model))
    return ImageState(pose, appearance)


def _gradient_after(
    step: Float[ArrayLike, "k"],
    args: tuple[ImageState, Group, Group, Cross],
    drawing: Drawing,
    model: PoseModel,
) -> Float[ArrayLike, "k"]:
    """J^T r after a step from a state, summed over all pixels at once, J being held."""
    state, near_circles, near_lines, cross = args

    def homography_after(step: Float[ArrayLike, "k"]) -> Float[ArrayLike, "3 3"]:
        pose = state.pose.retract(step[: model.size], model, step_unit_mm(state.pose, model))
        return sheet_from_camera(pose)

    by_step = jax.jacfwd(homography_after)(step).reshape(9, -1)
    appearance_by_step = jnp.eye(NUISANCE, len(step), model.size, dtype=step.dtype)
    chain = jax.lax.stop_gradient(jnp.concatenate([by_step, appearance_by_step]))
    after = _after(state, step, model)
    shared = homography_after(step), after.appearance
    total = jnp.zeros_like(step)
    for group, near_line in ((near_circles, False), (near_lines, True)):
        one = partial(predict, cross=cross, drawing=drawing, near_line=near_line)
        prediction = jax.vmap(one, in_axes=(None, None, 0))(*shared, group.pixels)
        columns = jnp.stack((*prediction.by_homography, *prediction.by_appearance))
        weighted = group.pixels.weight * prediction.residual
        total = total + chain.T @ (jax.lax.stop_gradient(columns) @ weighted)
    return total
