"""Newton's method for the inverse of a smooth mapping of the plane."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics import ArrayLike

NEWTON_STEPS = 8


def inverse_in_plane(
    mapping: Callable[[Float[ArrayLike, "2"]], Float[ArrayLike, "2"]],
    image: Float[ArrayLike, "2"],
) -> Float[ArrayLike, "2"]:
    """The point that `mapping`, a deformation near the identity, takes to `image`.

    Converges to rounding error wherever a lens maps one to one between the optical axis
    and the point; beyond the radius where distortion folds back the result is meaningless.
    """
    jacobian_of = jax.jacfwd(mapping)

    def step(_: ArrayLike, point: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        residual = mapping(point) - image
        (a, b), (c, d) = jacobian_of(point)
        return point - jnp.stack(
            [d * residual[0] - b * residual[1], a * residual[1] - c * residual[0]]
        ) / (a * d - b * c)

    return jax.lax.fori_loop(0, NEWTON_STEPS, step, jnp.asarray(image))
