"""Least squares over the poses of all cameras, their lenses and the shape of their sheet.

What the user states with a standard deviation is an unknown with that prior: D. C. Brown, "The
bundle adjustment - progress and prospects", 1976, calls this self-calibration with additional
parameters.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.flatten_util
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Bool, Float, Int

from trinoc.calib.adjustment.sheet_shape import point_of_place
from trinoc.calib.model import SheetPoints
from trinoc.geometry import AbstractLens, Pose, PoseModel, project_point
from trinoc.numerics import ArrayLike, GemanMcClure, kept_jit

_TOLERANCE = 1e-7
# Steps without damping go wrong soon or not at all.
_MOST_STEPS, _MOST_DAMPED_STEPS = 15, 60
# By which rounding may raise the cost of an answer from which nothing moves, as a share.
_ROUNDING = 1e-9


class Unknowns(NamedTuple):
    """What is adjusted, as changes from where it starts.

    Fields
    ------
    pose : (v, p) steps of `Pose.retract`, lengths in units of each camera's distance.
    lens : (l, r) of each lens, in standard deviations of its prior.
    shape : (s,) of the sheet, in standard deviations of its prior.
    """

    pose: Float[ArrayLike, "v p"]
    lens: Float[ArrayLike, "l r"]
    shape: Float[ArrayLike, "s"]


class Views(NamedTuple):
    """What is known before the adjustment; leaves have a first axis v unless it says otherwise.

    Fields
    ------
    pose, lens : from which changes are counted; lenses of one model.
    lens_factor : (v, q, r) change of the lens's parameters by a unit of `Unknowns.lens`.
    lens_index : row of `Unknowns.lens` that is this camera's lens.
    aim_weight : one over the standard deviation of the aim in mm; 0 for none.
    held : 1 for a padded camera, which stays where it is, else 0.
    points : what the pictures show.
    outlier_scale : of the bound on each place's influence, in its standard deviations.
    shape_sigma : (s,) of all cameras' one sheet.
    reach_mm : () distance from the origin at which its heights count.
    """

    pose: Pose
    lens: AbstractLens
    lens_factor: Float[ArrayLike, "v q r"]
    lens_index: Int[ArrayLike, "v"]
    aim_weight: Float[ArrayLike, "v"]
    held: Float[ArrayLike, "v"]
    points: SheetPoints
    outlier_scale: Float[ArrayLike, "v"]
    shape_sigma: Float[ArrayLike, "s"]
    reach_mm: Float[ArrayLike, ""]


class Adjusted(NamedTuple):
    """Where the adjustment ended.

    Fields
    ------
    unknowns : see `Unknowns`.
    pose, lens : (v,) of the cameras.
    shape : (s,) of the sheet, see `SHAPE_NAMES`.
    residuals_px : (v, n, 2) predicted minus observed.
    whitened : (v, 2n) the same in standard deviations.
    by_pose : (v, 2n, 6) of `whitened` by each camera's step of AIM_FREE, lengths in units of its
        distance.
    by_lens : (v, 2n, q) by the parameters of each camera's lens.
    by_shape : (v, 2n, s) by the sheet's shape.
    d_parameters_d_pose : (v, p, p) of the named parameters, in rad and mm, by the step of the
        pose from where it ended.
    converged : whether the solver says so, at no larger cost than where it began.
    """

    unknowns: Unknowns
    pose: Pose
    lens: AbstractLens
    shape: Float[ArrayLike, "s"]
    residuals_px: Float[ArrayLike, "v n 2"]
    whitened: Float[ArrayLike, "v m"]
    by_pose: Float[ArrayLike, "v m 6"]
    by_lens: Float[ArrayLike, "v m q"]
    by_shape: Float[ArrayLike, "v m s"]
    d_parameters_d_pose: Float[ArrayLike, "v p p"]
    converged: Bool[ArrayLike, ""]


def adjust(start: Unknowns, views: Views, *, model: PoseModel) -> Adjusted:
    """The unknowns of least cost, from `start`, and what they are known by.

    Circles give a start so near that three to eight steps of Gauss and Newton do; damping, which
    crawls where rounding hides the last gains, is for what is left.
    """
    found = _adjust(start, views, model=model, damped=False)
    return found if found.converged else _adjust(start, views, model=model, damped=True)


@partial(kept_jit, static_argnames=("model", "damped"))
def _adjust(start: Unknowns, views: Views, *, model: PoseModel, damped: bool) -> Adjusted:
    method = optx.LevenbergMarquardt if damped else optx.GaussNewton
    solver = method(rtol=_TOLERANCE, atol=_TOLERANCE, linear_solver=lx.Normal(lx.Cholesky()))
    # One vector each way: unknowns and costs by kind would make a block of every pair of kinds.
    begin, unflatten = jax.flatten_util.ravel_pytree(start)
    solution = optx.least_squares(
        lambda vector, views: _costs(model, unflatten(vector), views),
        solver,
        begin,
        args=views,
        max_steps=_MOST_DAMPED_STEPS if damped else _MOST_STEPS,
        throw=False,
    )
    found = unflatten(solution.value)
    before, after = (jnp.sum(_costs(model, one, views) ** 2) for one in (start, found))
    pose, lens = _cameras(found, views, model)
    shape = views.shape_sigma * found.shape
    look = partial(_derivatives, shape, views.reach_mm)
    whitened, by_pose, by_lens, by_shape = jax.vmap(look)(pose, lens, views.points)
    residuals = jax.vmap(_residuals_view, in_axes=(0, 0, None, 0, None))(
        pose, lens, shape, views.points, views.reach_mm
    )
    return Adjusted(
        found,
        pose,
        lens,
        shape,
        residuals,
        whitened,
        by_pose,
        by_lens,
        by_shape,
        jax.vmap(lambda one: one.d_parameters_d_delta(model, one.distance_mm, one))(pose),
        (solution.result == optx.RESULTS.successful) & (after <= before * (1 + _ROUNDING)),
    )


def _derivatives(
    shape: Float[ArrayLike, "s"],
    reach_mm: Float[ArrayLike, ""],
    pose: Pose,
    lens: AbstractLens,
    points: SheetPoints,
) -> tuple[
    Float[ArrayLike, "m"], Float[ArrayLike, "m 6"], Float[ArrayLike, "m q"], Float[ArrayLike, "m s"]
]:
    """Whitened residuals of one camera, and their derivatives by pose, lens and shape."""
    sizes = PoseModel.AIM_FREE.size, len(lens.parameter_names), len(shape)
    ends = np.cumsum(sizes)

    def whitened(change: Float[ArrayLike, "k"]) -> tuple:
        step, by_lens, by_shape = jnp.split(change, ends[:-1])
        moved = pose.retract(step, PoseModel.AIM_FREE, pose.distance_mm)
        value = _whitened_view(moved, lens.retract(by_lens), shape + by_shape, points, reach_mm)
        return value, value

    columns, value = jax.jacfwd(whitened, has_aux=True)(jnp.zeros(sum(sizes)))
    by_pose, by_lens, by_shape = jnp.split(columns, ends[:-1], axis=1)
    return value, by_pose, by_lens, by_shape


def _costs(model: PoseModel, unknowns: Unknowns, views: Views) -> Float[ArrayLike, "c"]:
    """Everything that is squared and summed."""
    whitened = _whitened(unknowns, views, model)
    pairs = whitened.reshape(len(whitened), -1, 2)
    squared = jnp.sum(pairs * pairs, axis=2, keepdims=True)
    bounded = jax.vmap(
        lambda scale, pair, square: GemanMcClure.from_scale(scale).bounded(pair, square)
    )(views.outlier_scale, pairs, squared)
    held = views.held[:, None] * unknowns.pose
    costs = bounded, held, unknowns.lens, unknowns.shape, _aims(unknowns, views, model)
    return jnp.concatenate([jnp.ravel(cost) for cost in costs])


def _cameras(unknowns: Unknowns, views: Views, model: PoseModel) -> tuple[Pose, AbstractLens]:
    pose = jax.vmap(lambda one, step: one.retract(step, model, one.distance_mm))(
        views.pose, unknowns.pose
    )
    change = jnp.einsum("vqr,vr->vq", views.lens_factor, unknowns.lens[views.lens_index])
    return pose, jax.vmap(lambda one, delta: one.retract(delta))(views.lens, change)


def _whitened(unknowns: Unknowns, views: Views, model: PoseModel) -> Float[ArrayLike, "v m"]:
    pose, lens = _cameras(unknowns, views, model)
    shape = views.shape_sigma * unknowns.shape
    return jax.vmap(_whitened_view, in_axes=(0, 0, None, 0, None))(
        pose, lens, shape, views.points, views.reach_mm
    )


def _aims(unknowns: Unknowns, views: Views, model: PoseModel) -> Float[ArrayLike, "v 2"]:
    pose, _ = _cameras(unknowns, views, model)
    return views.aim_weight[:, None] * jax.vmap(lambda one: one.aim_mm)(pose)


def _residuals_view(
    pose: Pose,
    lens: AbstractLens,
    shape: Float[ArrayLike, "s"],
    points: SheetPoints,
    reach_mm: Float[ArrayLike, ""],
) -> Float[ArrayLike, "n 2"]:
    """Predicted minus observed."""

    def predicted(place: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        return project_point(pose, lens, point_of_place(place, shape, reach_mm))

    return jax.vmap(predicted)(points.place_mm) - points.uv_px


def _whitened_view(
    pose: Pose,
    lens: AbstractLens,
    shape: Float[ArrayLike, "s"],
    points: SheetPoints,
    reach_mm: Float[ArrayLike, ""],
) -> Float[ArrayLike, "m"]:
    residuals = _residuals_view(pose, lens, shape, points, reach_mm)
    return points.whitening @ residuals.reshape(-1)


residuals_px = jax.jit(_residuals_view)
