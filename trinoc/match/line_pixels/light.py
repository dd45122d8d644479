"""A picture as the light that its grey levels stand for, with its noise."""

from typing import Literal, NamedTuple

import cv2
import jax
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.errors import InputError
from trinoc.numerics import grey_image, light_of_level, noise_sigma

Response = Literal["linear", "srgb"] | float
_BENDS = {"linear": 0.0, "srgb": 1.0}
_LEAST_BEND, _MOST_BEND = -1.0, 2.0
_KNOTS = 4096
# Beside clipped pixels levels are not what they were before blur and noise, either.
_CLIPPED_PX = 5


class Light(NamedTuple):
    """Fields
    ------
    light : (h, w) in 255ths of full white. noise : standard deviation between pixels.
    clipped : (h, w) whether a pixel is saturated, or near one that is.
    """

    light: Float[np.ndarray, "h w"]
    noise: float
    clipped: Bool[np.ndarray, "h w"]


def light_of_picture(picture: Shaped[np.ndarray, "..."], response: Response) -> Light:
    """The light of a picture's grey levels. Raises InputError for what is no picture."""
    bend = _BENDS.get(response) if isinstance(response, str) else float(response)
    if bend is None or not _LEAST_BEND <= bend <= _MOST_BEND:
        raise InputError(
            f'response is {response!r}, but must be "linear", "srgb" or a number from '
            f"{_LEAST_BEND:g} to {_MOST_BEND:g} (0 is linear, 1 is sRGB)."
        )
    given = grey_image(picture)
    kernel = np.ones((_CLIPPED_PX, _CLIPPED_PX), np.uint8)
    clipped = cv2.dilate((given.grey >= given.white).astype(np.uint8), kernel) > 0
    light, quantum = given.grey * np.float32(255 / given.full), given.quantum * 255 / given.full
    if bend:
        brightest = max(float(light.max()) / 255, 1.0)
        knots = np.linspace(0.0, brightest, round(_KNOTS * brightest))
        values = np.asarray(jax.vmap(light_of_level, (0, None))(knots, np.asarray(bend)))
        light = np.interp(light.ravel() / 255, knots, 255 * values).reshape(light.shape)
        light, quantum = light.astype(np.float32), 0.0
    # Rounding alone is noise, too, where nothing else is.
    noise = float(np.hypot(noise_sigma(light, quantum=quantum), quantum / np.sqrt(12) * 0.5))
    return Light(light, max(noise, 1e-3), clipped)
