"""How far a fragment's two ends lie from the projected line, in units of their sigma.

Only the distances across the line count: where a fragment ends along the line says how the
detector cut it, not where the camera stands.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.geometry import line_through, project_by_matrix, signed_distance
from trinoc.numerics import ArrayLike


def distances_across(
    matrix_px: Float[ArrayLike, "3 4"],
    anchors_mm: Float[ArrayLike, "2 3"],
    fragment_px: Float[ArrayLike, "2 2"],
) -> Float[ArrayLike, "2"]:
    """Signed distances (undistorted px) of the two ends from the image of the line."""
    line = line_through(*(project_by_matrix(matrix_px, anchors_mm[end]) for end in range(2)))
    return jnp.stack([signed_distance(line, fragment_px[0]), signed_distance(line, fragment_px[1])])


def whitening_across(
    fragment_px: Float[ArrayLike, "2 2"], covariance_px2: Float[ArrayLike, "4 4"]
) -> Float[ArrayLike, "2 2"]:
    """W with W S W^T = I for the covariance S of the two ends' distances across the fragment."""
    direction = fragment_px[1] - fragment_px[0]
    direction = direction / jnp.sqrt(direction @ direction)
    normal = jnp.stack([-direction[1], direction[0]])
    blocks = covariance_px2.reshape(2, 2, 2, 2)
    variance = jnp.einsum("i,aibj,j->ab", normal, blocks, normal)
    first = jnp.sqrt(variance[0, 0])
    slope = variance[0, 1] / first
    second = jnp.sqrt(variance[1, 1] - slope**2)
    zero = jnp.zeros_like(first)
    return jnp.stack(
        [jnp.stack([1 / first, zero]), jnp.stack([-slope / (first * second), 1 / second])]
    )
