"""Predicted minus observed centres of the circles of many pictures through one lens."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from trinoc.calib.model import CircleObservations
from trinoc.geometry import (
    Pose,
    centre_of_mapped_ellipse,
    distort,
    dual_conic_of_circle,
    transform_dual_conic,
)
from trinoc.numerics import ArrayLike


class LensChart(NamedTuple):
    """Where a fit starts and in which directions it may move; zero steps leave it there.

    Fields
    ------
    values : (9,) LENS_PARAMETERS.
    scale : (9,) their units (`parameter_scale`).
    directions : (9, 9) scaled change of the values with each unknown (`free_directions`).
    cam_from_world : (k, 3, 4) the pose of each picture, mm.
    """

    values: Float[ArrayLike, "9"]
    scale: Float[ArrayLike, "9"]
    directions: Float[ArrayLike, "9 9"]
    cam_from_world: Float[ArrayLike, "k 3 4"]


@jax.custom_jvp
def predicted_centre_px(
    values: Float[ArrayLike, "9"],
    cam_from_world: Float[ArrayLike, "3 4"],
    centre_sheet_mm: Float[ArrayLike, "2"],
    radius_mm: Float[ArrayLike, ""],
) -> Float[Array, "2"]:
    """Centre of the ellipse that images a circle: `geometry.conics.image_of_circle_centre`.

    Its derivative is a small matrix that is computed once: the solver applies it to many
    vectors, and what it has to compile is a product instead of the whole model, again and again.
    """
    homography = cam_from_world[:, jnp.array([0, 1, 3])]
    ellipse = transform_dual_conic(homography, dual_conic_of_circle(centre_sheet_mm, radius_mm))
    centre = centre_of_mapped_ellipse(ellipse, lambda ideal: distort(ideal, values[4:]))
    return jnp.asarray(values[:2] * centre + values[2:4])


@predicted_centre_px.defjvp
def _derivative(primals: tuple[Array, ...], tangents: tuple[Array, ...]) -> tuple[Array, Array]:
    model = predicted_centre_px.fun
    matrices = jax.jacfwd(model, argnums=(0, 1, 2, 3))(*primals)
    products = [jnp.tensordot(d, t, jnp.ndim(t)) for d, t in zip(matrices, tangents, strict=True)]
    return model(*primals), sum(products, jnp.zeros_like(products[0]))


def moved_pose(
    cam_from_world: Float[ArrayLike, "3 4"], motion: Float[ArrayLike, "6"]
) -> Float[Array, "3 4"]:
    """`Pose.moved` with the displacement of the centre in shares of its distance from the origin.

    In these units the standard deviations of all six numbers are comparable.
    """
    translation = cam_from_world[:, 3]
    distance = jax.lax.stop_gradient(jnp.sqrt(translation @ translation))
    unit = jnp.concatenate([jnp.ones(3), jnp.broadcast_to(distance, (3,))])
    return jnp.asarray(Pose(cam_from_world).moved(unit * motion).cam_from_world)


def whitened_residuals(
    lens_step: Float[ArrayLike, "9"],
    motions: Float[ArrayLike, "k 6"],
    chart: LensChart,
    circles: CircleObservations,
) -> Float[Array, "k n 2"]:
    """Residuals of all circles in units of their own standard deviations; zero where unused."""
    values = chart.values + chart.scale * (chart.directions @ lens_step)
    poses = jax.vmap(moved_pose)(chart.cam_from_world, motions)
    return jnp.einsum("knij,knj->kni", circles.whitening, residuals_px(values, poses, circles))


def residuals_px(
    values: Float[ArrayLike, "9"],
    cam_from_world: Float[ArrayLike, "k 3 4"],
    circles: CircleObservations,
) -> Float[Array, "k n 2"]:
    """Predicted minus observed centre of every circle of every picture."""
    of_image = jax.vmap(predicted_centre_px, in_axes=(None, None, 0, 0))
    of_all = jax.vmap(of_image, in_axes=(None, 0, 0, 0))
    predicted = of_all(values, cam_from_world, circles.centres_sheet_mm, circles.radius_mm)
    return predicted - circles.centres_px


def information_of_images(
    values: Float[ArrayLike, "9"],
    scale: Float[ArrayLike, "9"],
    cam_from_world: Float[ArrayLike, "k 3 4"],
    circles: CircleObservations,
) -> Float[Array, "k 15 15"]:
    """J^T J of each picture's whitened residuals.

    The unknowns are the nine parameters of the lens in units of `scale`, and the picture's
    own motion (`moved_pose`).
    """

    def whitened_centre(
        step: Float[Array, "15"],
        cam_from_world: Float[Array, "3 4"],
        whitening: Float[Array, "2 2"],
        centre_sheet_mm: Float[Array, "2"],
        radius_mm: Float[Array, ""],
    ) -> Float[Array, "2"]:
        moved = moved_pose(cam_from_world, step[9:])
        lens = values + scale * step[:9]
        return whitening @ predicted_centre_px(lens, moved, centre_sheet_mm, radius_mm)

    of_circle = jax.jacfwd(whitened_centre)
    of_image = jax.vmap(of_circle, in_axes=(None, None, 0, 0, 0))
    of_all = jax.vmap(of_image, in_axes=(None, 0, 0, 0, 0))
    jacobian = of_all(
        jnp.zeros(15, jnp.asarray(values).dtype),
        jnp.asarray(cam_from_world),
        jnp.asarray(circles.whitening),
        jnp.asarray(circles.centres_sheet_mm),
        jnp.asarray(circles.radius_mm),
    )
    return jnp.einsum("kniq,knir->kqr", jacobian, jacobian)
