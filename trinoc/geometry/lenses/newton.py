"""Newton's method for the inverse of a smooth mapping of the plane."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Float

from trinoc.numerics.precision import ArrayLike

NEWTON_STEPS = 8
# A step from the solution doubles the order up to which derivatives are those of the inverse, so
# two give all up to the third; the steps before need none.
_DIFFERENTIATED_STEPS = 2


def inverse_in_plane(
    mapping: Callable[[Float[ArrayLike, "2"]], Float[ArrayLike, "2"]],
    image: Float[ArrayLike, "2"],
    steps: int = NEWTON_STEPS,
) -> Float[ArrayLike, "2"]:
    """The point that `mapping`, a deformation near the identity, takes to `image`.

    Converges to rounding error wherever a lens maps one to one between the optical axis
    and the point; beyond the radius where distortion folds back the result is meaningless.
    Derivatives, by `image` and by what `mapping` holds, are right up to the third.
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
    """Where so many steps of Newton's method lead, with derivatives of the solution."""
    before = jax.lax.fori_loop(0, steps - _DIFFERENTIATED_STEPS, step, start)
    return jax.lax.fori_loop(0, _DIFFERENTIATED_STEPS, step, jax.lax.stop_gradient(before))
