"""Predicted minus observed centres of the circles of many pictures through one lens."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from trinoc.calib.model import CircleObservations
from trinoc.geometry import (
    AbstractLens,
    Pose,
    PoseModel,
    centre_of_mapped_ellipse,
    dual_conic_of_circle,
    ray_of_normalised,
    transform_dual_conic,
)
from trinoc.numerics import ArrayLike


class LensChart(NamedTuple):
    """Where a fit starts and in which directions it may move; zero steps leave it there.

    Fields
    ------
    lens : q parameters.
    scale : (q,) their units (`parameter_scales`).
    directions : (q, q) scaled change of the parameters with each unknown (`free_directions`).
    cam_from_world : (k, 3, 4) the pose of each picture, mm.
    """

    lens: AbstractLens
    scale: Float[ArrayLike, "q"]
    directions: Float[ArrayLike, "q q"]
    cam_from_world: Float[ArrayLike, "k 3 4"]

    def stepped_lens(self, step: Float[ArrayLike, "q"]) -> AbstractLens:
        """The lens after a step of the unknowns."""
        return self.lens.retract(self.scale * (self.directions @ step))


@jax.custom_jvp
def predicted_centre_px(
    lens: AbstractLens,
    cam_from_world: Float[ArrayLike, "3 4"],
    centre_sheet_mm: Float[ArrayLike, "2"],
    radius_mm: Float[ArrayLike, ""],
) -> Float[Array, "2"]:
    """Centre of the ellipse that images a circle: `geometry.conics.image_of_circle_centre`.

    Its derivative is a small matrix that is computed once: the solver applies it to many
    vectors, and what it has to compile is a product instead of the whole model, again and again.
    """
    circle = dual_conic_of_circle(centre_sheet_mm, radius_mm)
    ellipse = transform_dual_conic(Pose(cam_from_world).cam_from_sheet, circle)
    # K is affine and maps centres to centres; near 0 the sums round less than in pixels.
    centre = centre_of_mapped_ellipse(ellipse, lambda ideal: lens.distort(ray_of_normalised(ideal)))
    return jnp.asarray(lens.affine(centre))


@predicted_centre_px.defjvp
def _derivative(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    model = predicted_centre_px.fun
    matrices = jax.tree.leaves(jax.jacfwd(model, argnums=(0, 1, 2, 3))(*primals))
    changes = jax.tree.leaves(tangents)
    products = [jnp.tensordot(d, t, jnp.ndim(t)) for d, t in zip(matrices, changes, strict=True)]
    return model(*primals), sum(products, jnp.zeros_like(products[0]))


def retract_pose(
    cam_from_world: Float[ArrayLike, "3 4"], motion: Float[ArrayLike, "6"]
) -> Float[Array, "3 4"]:
    """`Pose.retract` of a rigid motion, in shares of the centre's distance from the origin.

    In these units the standard deviations of all six numbers are comparable.
    """
    translation = cam_from_world[:, 3]
    distance = jax.lax.stop_gradient(jnp.sqrt(translation @ translation))
    stepped = Pose(cam_from_world).retract(motion, PoseModel.RIGID, distance)
    return jnp.asarray(stepped.cam_from_world)


def whitened_residuals(
    lens_step: Float[ArrayLike, "q"],
    motions: Float[ArrayLike, "k 6"],
    chart: LensChart,
    circles: CircleObservations,
) -> Float[Array, "k n 2"]:
    """Residuals of all circles in units of their own standard deviations; zero where unused."""
    lens = chart.stepped_lens(lens_step)
    poses = jax.vmap(retract_pose)(chart.cam_from_world, motions)
    return jnp.einsum("knij,knj->kni", circles.whitening, residuals_px(lens, poses, circles))


def residuals_px(
    lens: AbstractLens,
    cam_from_world: Float[ArrayLike, "k 3 4"],
    circles: CircleObservations,
) -> Float[Array, "k n 2"]:
    """Predicted minus observed centre of every circle of every picture."""
    of_image = jax.vmap(predicted_centre_px, in_axes=(None, None, 0, 0))
    of_all = jax.vmap(of_image, in_axes=(None, 0, 0, 0))
    predicted = of_all(lens, cam_from_world, circles.centres_sheet_mm, circles.radius_mm)
    return predicted - circles.centres_px


def information_of_images(
    lens: AbstractLens,
    scale: Float[ArrayLike, "q"],
    cam_from_world: Float[ArrayLike, "k 3 4"],
    circles: CircleObservations,
) -> Float[Array, "k s s"]:
    """J^T J of each picture's whitened residuals.

    The s = q + 6 unknowns are the parameters of the lens in units of `scale`, and the picture's
    own motion (`retract_pose`).
    """
    count = len(lens.parameter_names)

    def whitened_centre(
        step: Float[Array, "s"],
        cam_from_world: Float[Array, "3 4"],
        whitening: Float[Array, "2 2"],
        centre_sheet_mm: Float[Array, "2"],
        radius_mm: Float[Array, ""],
    ) -> Float[Array, "2"]:
        pose = retract_pose(cam_from_world, step[count:])
        stepped = lens.retract(scale * step[:count])
        return whitening @ predicted_centre_px(stepped, pose, centre_sheet_mm, radius_mm)

    of_circle = jax.jacfwd(whitened_centre)
    of_image = jax.vmap(of_circle, in_axes=(None, None, 0, 0, 0))
    of_all = jax.vmap(of_image, in_axes=(None, 0, 0, 0, 0))
    jacobian = of_all(
        jnp.zeros(count + PoseModel.RIGID.size, jnp.asarray(scale).dtype),
        jnp.asarray(cam_from_world),
        jnp.asarray(circles.whitening),
        jnp.asarray(circles.centres_sheet_mm),
        jnp.asarray(circles.radius_mm),
    )
    return jnp.einsum("kniq,knir->kqr", jacobian, jacobian)
