"""The fitted unknowns as a differentiable function of what the pixels hold.

The fit ends where J^T W r, summed over the pixels and the priors, vanishes. By the implicit
function theorem its answer follows the grey levels, the rays (and with them the lens), the circles
and the cross, without differentiating the steps that led there. J is held where it stands, as in
Gauss-Newton: what its own change adds is weighted by residuals, which are noise of no sign.
"""

from functools import partial

import jax
import jax.numpy as jnp
import lineax as lx
import optimistix as optx
from jaxtyping import Float

from trinoc.calib.photometric.equations import Picture, homography_and_slope, pixel_rows
from trinoc.calib.photometric.ink import Drawing
from trinoc.calib.photometric.unknowns import PictureState
from trinoc.geometry import PoseModel
from trinoc.numerics import ArrayLike


def differentiable_fit(
    state: PictureState, picture: Picture, *, drawing: Drawing, model: PoseModel
) -> PictureState:
    """`state`, where a fit of all unknowns ended, with its derivatives by the picture.

    Those by `state` itself are zero. Pixels are in double precision, and light is not local. For
    use under `jit`, `jvp` and `grad`.
    """
    state = jax.lax.stop_gradient(state)
    solution = optx.root_find(
        partial(_gradient_after, drawing=drawing, model=model),
        optx.Newton(0.0, 0.0),
        jnp.zeros(model.size + state.unknowns.size),
        args=(state, picture),
        adjoint=optx.ImplicitAdjoint(lx.LU()),
        # None: the fit has been made.
        max_steps=0,
        throw=False,
    )
    return state.moved(solution.value, state.levels, model)


def _gradient_after(
    step: Float[ArrayLike, "k"],
    args: tuple[PictureState, Picture],
    drawing: Drawing,
    model: PoseModel,
) -> Float[ArrayLike, "k"]:
    """J^T W r after a step from a state, summed over all pixels at once, J being held."""
    state, picture = args
    after = state.moved(step, state.levels, model)
    homography, by_motion = homography_and_slope(after, model)
    by_motion = jax.lax.stop_gradient(by_motion)
    middle, weight = picture.prior
    total = jnp.concatenate([jnp.zeros(model.size), weight * (after.values - middle)])
    for group, near_line in ((picture.near_circles, False), (picture.near_lines, True)):
        seen = pixel_rows(homography, after, group, picture, drawing, near_line)
        rows = jax.lax.stop_gradient(seen.rows)
        root = group.pixels.weight / jax.lax.stop_gradient(seen.sigma)
        summed = rows @ (root * root * seen.residual)
        total = total + jnp.concatenate([by_motion.T @ summed[:9], summed[9:]])
    return total
