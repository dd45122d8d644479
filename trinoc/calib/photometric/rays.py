"""The rays of pixels through a lens, with or without distortion."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.photometric.sheet_point import Ray
from trinoc.geometry import AbstractLens
from trinoc.numerics import ArrayLike

# Pieces of one length, so that another number of pixels does not compile again.
_PIECE = 8192


def rays_of_pixels(lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"]) -> Ray:
    """The ray of each pixel: (n, 2) normalised, and (n, 2, 2) its derivative."""
    if lens.has_distortion:
        return _through_distortion(lens, uv_px)
    (fu, fv), (cu, cv) = np.asarray(lens.focal_length_px), np.asarray(lens.principal_point_px)
    skew = float(lens.skew_px)
    y = (uv_px[:, 1] - cv) / fv
    normalised = np.stack([(uv_px[:, 0] - cu - skew * y) / fu, y], axis=1)
    by_pixel = np.array([[1 / fu, -skew / (fu * fv)], [0.0, 1 / fv]])
    return Ray(normalised, np.broadcast_to(by_pixel, (len(uv_px), 2, 2)))


def _through_distortion(lens: AbstractLens, uv_px: Float[np.ndarray, "n 2"]) -> Ray:
    padded = np.concatenate([uv_px, np.zeros((-len(uv_px) % _PIECE, 2))])
    pieces = [_distorted_rays(lens, padded[k : k + _PIECE]) for k in range(0, len(padded), _PIECE)]
    normalised, by_pixel = (
        np.concatenate([np.asarray(field) for field in fields])[: len(uv_px)]
        for fields in zip(*pieces, strict=True)
    )
    return Ray(normalised, by_pixel)


@jax.jit
def _distorted_rays(lens: AbstractLens, uv_px: Float[ArrayLike, "n 2"]) -> Ray:
    def ray(uv: Float[ArrayLike, "2"]) -> Ray:
        return Ray(lens.normalised_from_pixel(uv), jax.jacfwd(lens.normalised_from_pixel)(uv))

    return jax.vmap(ray)(uv_px)
