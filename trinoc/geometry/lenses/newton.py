"""Newton's method for the inverse of a smooth mapping of the plane."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike

NEWTON_STEPS = 8
# A step at the solution doubles the order up to which derivatives are exact. So two steps give
# them up to the third order; earlier steps need no derivatives.
_DIFFERENTIATED_STEPS = 2


def inverse_in_plane(
    mapping: Callable[[Float[ArrayLike, "2"]], Float[ArrayLike, "2"]],
    image: Float[ArrayLike, "2"],
    steps: int = NEWTON_STEPS,
) -> Float[ArrayLike, "2"]:
    """Return the point (2,) that `mapping`, a deformation near the identity, maps to `image`.

    Newton's method converges to rounding error if the lens is one to one between the optical axis
    and the point. Beyond the fold of the distortion the result is meaningless. Derivatives by
    `image` and by the parameters of `mapping` are exact up to the third order.
    """
    jacobian_of = jax.jacfwd(mapping)

    def step(_: ArrayLike, point: Float[ArrayLike, "2"]) -> Float[ArrayLike, "2"]:
        residual = mapping(point) - image
        (a, b), (c, d) = jacobian_of(point)
        return point - jnp.stack(
            [d * residual[0] - b * residual[1], a * residual[1] - c * residual[0]]
        ) / (a * d - b * c)

    return newton_iterations(step, jnp.asarray(image), steps)


def newton_iterations(
    step: Callable[[ArrayLike, Float[ArrayLike, "*n"]], Float[ArrayLike, "*n"]],
    start: Float[ArrayLike, "*n"],
    steps: int,
) -> Float[ArrayLike, "*n"]:
    """Apply `step` a fixed number of times, starting at `start`; return the last iterate.

    `step` maps (iteration index, iterate) to the next iterate. Automatic differentiation passes
    through the last two steps only, which is enough for derivatives up to the third order.
    """
    before = jax.lax.fori_loop(0, steps - _DIFFERENTIATED_STEPS, step, start)
    return jax.lax.fori_loop(0, _DIFFERENTIATED_STEPS, step, jax.lax.stop_gradient(before))
