"""Four numbers for a line in space, with no gauge left in them.

A line is held by two anchor points X1, X2 on it. Near it, any line that is not at right
angles to it cuts the two planes through the anchors normal to the line, each in one point:
two offsets in either plane are a chart (the minimal parametrisation of a line; compare
Bartoli and Sturm 2005, doi:10.1016/j.cviu.2005.06.001). After a step the chart is laid anew.
"""

import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics import ArrayLike


def normals_of(direction: Float[ArrayLike, "3"]) -> Float[ArrayLike, "2 3"]:
    """Two unit vectors that complete a direction to an orthogonal basis."""
    axis = direction / jnp.sqrt(direction @ direction)
    # The coordinate axis that is most across the direction cannot be parallel to it.
    across = jnp.eye(3)[jnp.argmin(jnp.abs(axis))]
    first = jnp.cross(axis, across)
    first = first / jnp.sqrt(first @ first)
    return jnp.stack([first, jnp.cross(axis, first)])


def moved_anchors(
    anchors_mm: Float[ArrayLike, "2 3"], offsets_mm: Float[ArrayLike, "4"]
) -> Float[ArrayLike, "2 3"]:
    """Where the anchors go under the four offsets (two across the line at each anchor)."""
    return anchors_mm + offsets_mm.reshape(2, 2) @ normals_of(anchors_mm[1] - anchors_mm[0])
