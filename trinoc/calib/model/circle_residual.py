"""Predicted minus observed centre of the ellipse that images one circle."""

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.calib.model.observed_circles import CircleObservations
from trinoc.geometry import (
    AbstractLens,
    Pose,
    centre_of_mapped_ellipse,
    dual_conic_of_circle,
    transform_dual_conic,
)
from trinoc.numerics import ArrayLike


def predicted_centre_px(
    pose: Pose,
    lens: AbstractLens,
    centre_sheet_mm: Float[ArrayLike, "2"],
    radius_mm: Float[ArrayLike, ""],
) -> Float[ArrayLike, "2"]:
    """Centre of the ellipse that images a circle: `geometry.conics.image_of_circle_centre`.

    The centre needs the last column of H C* H^T alone, which costs a tenth of the product;
    calibration matrices are affine and map centres to centres.
    """
    homography = pose.cam_from_sheet
    if lens.has_distortion:
        circle = dual_conic_of_circle(centre_sheet_mm, radius_mm)
        ellipse = transform_dual_conic(homography, circle)
        return centre_of_mapped_ellipse(ellipse, lens.pixel_from_normalised)
    horizon = homography[2]
    depth = horizon[:2] @ centre_sheet_mm + horizon[2]
    pole = depth * centre_sheet_mm - radius_mm**2 * horizon[:2]
    column = homography[:, :2] @ pole + homography[:, 2] * depth
    return lens.affine(column[:2] / column[2])


def circle_residuals_px(
    pose: Pose, lens: AbstractLens, circles: CircleObservations
) -> Float[ArrayLike, "n 2"]:
    """Predicted minus observed centre of every circle, in pixels."""
    predict = jax.vmap(predicted_centre_px, in_axes=(None, None, 0, 0))
    return predict(pose, lens, circles.centres_sheet_mm, circles.radius_mm) - circles.centres_px


def whitened_residuals(
    pose: Pose, lens: AbstractLens, circles: CircleObservations
) -> Float[ArrayLike, "n 2"]:
    """Residuals in units of their own standard deviations; zero for unused rows."""
    return jnp.einsum("nij,nj->ni", circles.whitening, circle_residuals_px(pose, lens, circles))
