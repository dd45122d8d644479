"""How well a lens is known across the picture, in pixels."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from trinoc.geometry import AbstractLens, rotation_from_vector
from trinoc.numerics import ArrayLike

FIELD_PLACES = 5


def field_places_px(image_size_px: tuple[int, int]) -> Float[np.ndarray, "5 5 2"]:
    """Places from corner to corner of the picture, row by row from the top."""
    u, v = (np.linspace(0.0, side - 1.0, FIELD_PLACES) for side in image_size_px)
    return np.stack(np.meshgrid(u, v), axis=-1)


@jax.jit
def field_sigma_px(
    lens: AbstractLens,
    covariance: Float[ArrayLike, "q q"],
    places_px: Float[ArrayLike, "5 5 2"],
) -> Float[Array, "5 5"]:
    """Standard deviation, per axis, of where the lens images a given ray.

    A turn of the camera that all places share is taken out: whoever poses the camera finds
    it again, and a principal point that is off looks like one.
    """
    rays = jax.vmap(lens.unproject)(places_px.reshape(-1, 2))

    def pixel(
        values: Float[Array, "q"], turn: Float[Array, "3"], ray: Float[Array, "3"]
    ) -> Float[ArrayLike, "2"]:
        return lens.with_parameters(values).project_ray(rotation_from_vector(turn) @ ray)

    values, still = jnp.asarray(lens.parameters), jnp.zeros(3, rays.dtype)
    by_lens = jax.vmap(jax.jacfwd(pixel), in_axes=(None, None, 0))(values, still, rays)
    by_turn = jax.vmap(jax.jacfwd(pixel, argnums=1), in_axes=(None, None, 0))(values, still, rays)
    by_lens, by_turn = by_lens.reshape(-1, len(values)), by_turn.reshape(-1, 3)
    turn_of_lens = jnp.linalg.solve(by_turn.T @ by_turn, by_turn.T @ by_lens)
    remaining = by_lens - by_turn @ turn_of_lens
    variance = jnp.einsum("iq,qr,ir->i", remaining, covariance, remaining)
    return jnp.sqrt(jnp.mean(variance.reshape(FIELD_PLACES, FIELD_PLACES, 2), axis=2))
