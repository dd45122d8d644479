"""Where the edges of the sheet lie in a picture, as polygons."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.targets import Pattern
from trinoc.geometry import AbstractLens, Pose, project_point
from trinoc.numerics import ArrayLike

_CIRCLE_POINTS = 32
_SIDE_POINTS = 16


@jax.jit
def project_to_image(
    pose: Pose, lens: AbstractLens, points_mm: Float[ArrayLike, "n 2"]
) -> Float[ArrayLike, "n 2"]:
    """Pixels that image points of the sheet."""
    places = jnp.concatenate([points_mm, jnp.zeros_like(points_mm[:, :1])], axis=1)
    return jax.vmap(project_point, in_axes=(None, None, 0))(pose, lens, places)


def circle_points_mm(
    centres_mm: Float[np.ndarray, "n 2"], radius_mm: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n k 2"]:
    """Points on circles of the sheet."""
    angle = np.arange(_CIRCLE_POINTS) * (2 * np.pi / _CIRCLE_POINTS)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return centres_mm[:, None] + radius_mm[:, None, None] * ring


def line_outlines_mm(pattern: Pattern) -> Float[np.ndarray, "2 k 2"]:
    """Closed outlines of the line along X and of the line along Y."""
    along = np.linspace(-1.0, 1.0, _SIDE_POINTS)
    half = 0.5 * pattern.line_width_mm
    outlines = []
    for axis, reach in enumerate(pattern.line_half_length_mm):
        there = np.stack([reach * along, np.full(_SIDE_POINTS, half)], axis=1)
        outline = np.concatenate([there, -there])
        outlines.append(outline if axis == 0 else outline[:, ::-1])
    return np.stack(outlines)
