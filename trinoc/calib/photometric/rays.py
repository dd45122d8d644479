"""The rays of pixels through a lens, with or without distortion."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.sheet_point import Ray
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# Pieces of one length, so that another number of pixels does not compile again.
_PIECE = 8192


def rays_of_pixels(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], *, with_bend: bool = True
) -> Ray:
    """The ray of each pixel: (n, 3) directions, (n, 3, 2) and (n, 3, 3) their derivatives."""
    if lens.has_distortion:
        return _through_distortion(lens, uv_px, with_bend)
    (fu, fv), (cu, cv) = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    skew = float(lens.skew_px)
    y = (uv_px[:, 1] - cv) / fv
    direction = np.stack([(uv_px[:, 0] - cu - skew * y) / fu, y, np.ones_like(y)], axis=1)
    by_pixel = np.array([[1 / fu, -skew / (fu * fv)], [0.0, 1 / fv], [0.0, 0.0]])
    return Ray(direction, np.broadcast_to(by_pixel, (len(uv_px), 3, 2)))


def _through_distortion(
    lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"], with_bend: bool
) -> Ray:
    padded = np.concatenate([uv_px, np.zeros((-len(uv_px) % _PIECE, 2))])
    pieces = [
        _distorted_rays(lens, padded[k : k + _PIECE], with_bend=with_bend)
        for k in range(0, len(padded), _PIECE)
    ]
    return jax.tree.map(
        lambda *parts: np.concatenate([np.asarray(part) for part in parts])[: len(uv_px)], *pieces
    )


@partial(jax.jit, static_argnames="with_bend")
def _distorted_rays(lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"], *, with_bend: bool) -> Ray:
    def ray(uv: Float[ArrayLike, "2"]) -> Ray:
        first = jax.jacfwd(lens.unproject)
        if not with_bend:
            return Ray(lens.unproject(uv), first(uv))
        second = jax.jacfwd(first)(uv)
        bend = jnp.stack([second[:, 0, 0], second[:, 0, 1], second[:, 1, 1]], axis=1)
        return Ray(lens.unproject(uv), first(uv), bend)

    return jax.vmap(ray)(uv_px)
