"""Robust Gauss-Newton over the pose and the appearance of one picture."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Float, Int

from trinoc.calib.model import SheetPose
from trinoc.calib.photometric.appearance import NUISANCE, Appearance, Pixels
from trinoc.calib.photometric.ink_coverage import Cross, Drawing
from trinoc.calib.photometric.normal_equations import normal_equations
from trinoc.numerics import ArrayLike, inverse_3x3


class Group(NamedTuple):
    """Pixels that share a model: those near circles only, or those near a line too."""

    pixels: Pixels
    chunks: Int[ArrayLike, ""]


class ImageState(NamedTuple):
    """Everything that is unknown about one picture."""

    pose: SheetPose
    appearance: Appearance


class Step(NamedTuple):
    """One Gauss-Newton step, and the point that it was taken from.

    Fields
    ------
    state : after the step.
    information : (k, k) J^T W J of (pose chart, appearance), in 1 / grey level^2.
    length : of the step, in units of its own standard deviation for noise of one grey level.
    residuals : of both groups before the step, grey levels, padding included.
    """

    state: ImageState
    information: Float[ArrayLike, "k k"]
    length: Float[ArrayLike, ""]
    residuals: tuple[Float[ArrayLike, "n"], Float[ArrayLike, "m"]]


def gauss_newton_steps(
    state: ImageState,
    near_circles: Group,
    near_lines: Group,
    cross: Cross,
    outlier_scales: Float[ArrayLike, "s"],
    held: Float[ArrayLike, "s k"],
    stride: Int[ArrayLike, "s"],
    steps: Int[ArrayLike, ""],
    *,
    drawing: Drawing,
    parameter_count: int,
) -> Step:
    """The first `steps` of the steps that `outlier_scales` and `held` describe.

    outlier_scales : grey levels at which a residual loses its influence; infinity for none.
    held : 1 for each unknown that a step leaves as it is.
    stride : a step looks at the first of so many parts of each group's chunks only.
    """
    size = parameter_count + NUISANCE

    def step(k: Int[ArrayLike, ""], before: Step) -> Step:
        first, second = (
            group._replace(chunks=-(-group.chunks // stride[k]))
            for group in (near_circles, near_lines)
        )
        return _step(
            before.state,
            first,
            second,
            cross,
            outlier_scales[k],
            held[k],
            drawing,
            parameter_count,
        )

    dtype = state.pose.rotation.dtype
    start = Step(
        state,
        jnp.zeros((size, size), dtype),
        jnp.zeros((), dtype),
        (jnp.zeros_like(near_circles.pixels.grey), jnp.zeros_like(near_lines.pixels.grey)),
    )
    return jax.lax.fori_loop(0, steps, step, start)


def _step(
    state: ImageState,
    near_circles: Group,
    near_lines: Group,
    cross: Cross,
    outlier_scale: Float[ArrayLike, ""],
    held: Float[ArrayLike, "k"],
    drawing: Drawing,
    parameter_count: int,
) -> Step:
    zero = jnp.zeros(parameter_count, state.pose.rotation.dtype)

    def homography_after(motion: Float[ArrayLike, "p"]) -> Float[ArrayLike, "9"]:
        return sheet_from_normalised(state.pose.moved(motion)).reshape(9)

    homography, by_motion = homography_after(zero), jax.jacfwd(homography_after)(zero)
    sums = [
        normal_equations(
            homography.reshape(3, 3),
            state.appearance,
            group.pixels,
            group.chunks,
            cross,
            outlier_scale,
            drawing,
            near_line,
        )
        for group, near_line in ((near_circles, False), (near_lines, True))
    ]
    matrix = sums[0].matrix + sums[1].matrix
    slope = sums[0].gradient + sums[1].gradient
    chain = jnp.zeros((9 + NUISANCE, parameter_count + NUISANCE), zero.dtype)
    chain = chain.at[:9, :parameter_count].set(by_motion)
    chain = chain.at[9:, parameter_count:].set(jnp.eye(NUISANCE, dtype=zero.dtype))
    information, gradient = chain.T @ matrix @ chain, chain.T @ slope
    motion = -_solve(information, gradient, held)
    after = ImageState(
        state.pose.moved(motion[:parameter_count]),
        _kept_possible(state.appearance.vector + motion[parameter_count:]),
    )
    length = jnp.sqrt(-motion @ gradient)
    return Step(after, information, length, (sums[0].residuals, sums[1].residuals))


def sheet_from_normalised(pose: SheetPose) -> Float[ArrayLike, "3 3"]:
    """Homography from normalised image coordinates to the sheet, scaled by its last entry."""
    inverse = inverse_3x3(pose.cam_from_sheet)
    return inverse / inverse[2, 2]


def _solve(
    information: Float[ArrayLike, "k k"],
    gradient: Float[ArrayLike, "k"],
    held: Float[ArrayLike, "k"],
) -> Float[ArrayLike, "k"]:
    """Gauss-Newton step on the unknowns that are not held, with columns scaled alike."""
    free = 1 - held
    scale = jnp.sqrt(jnp.diag(information))
    scale = jnp.where((held > 0) | (scale == 0), jnp.ones_like(scale), scale)
    matrix = information * free[:, None] * free[None] / (scale[:, None] * scale[None])
    matrix = matrix + jnp.diag(held)
    factor = jax.scipy.linalg.cho_factor(matrix, lower=True)
    return jax.scipy.linalg.cho_solve(factor, free * gradient / scale) / scale


def _kept_possible(vector: Float[ArrayLike, "9"]) -> Appearance:
    """The appearance, with the blur kept from falling below a third of the pixel's own."""
    appearance = Appearance.from_vector(vector)
    return appearance._replace(sigma_px=jnp.maximum(appearance.sigma_px, 0.1))


run_steps = jax.jit(gauss_newton_steps, static_argnames=("drawing", "parameter_count"))
