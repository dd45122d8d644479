"""Grey levels on one scale for all pictures, so that a contrast means the same in each."""

from typing import Literal

import jax
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.errors import InputError
from trinoc.numerics import GreyImage, grey_image, in_float64, light_of_level

# How a camera makes grey levels of light: by name, or how far its curve bends.
Response = Literal["linear", "srgb"] | float
_BENDS = {"linear": 0.0, "srgb": 1.0}
_LEAST_BEND, _MOST_BEND = -1.0, 2.0
# Between so many knots to full white the curve is straight to a ten-thousandth of a level.
_KNOTS = 2048


def bend_of(response: str | float) -> float:
    """How far the curve of a response bends: 0 linear, 1 sRGB. Raises InputError."""
    bend = _BENDS.get(response) if isinstance(response, str) else float(response)
    if bend is None or not _LEAST_BEND <= bend <= _MOST_BEND:
        raise InputError(
            f'response is {response!r}, but must be "linear", "srgb" or a number from '
            f"{_LEAST_BEND:g} to {_MOST_BEND:g} (0 is linear, 1 is sRGB)."
        )
    return bend


def light_in_255ths(image: Shaped[np.ndarray, "..."], bend: float) -> Float[np.ndarray, "h w"]:
    """(h, w) the light that the grey levels of a picture stand for, with full white at 255.

    Of a colour, the mean of its channels' light. Below black there is none.
    """
    array = np.asarray(image)
    channels = array.shape[2] if array.ndim == 3 else 1
    if channels < 3:
        return _light(grey_in_255ths(array).grey, bend)
    # Side by side, the channels are one grey picture: all have the range of the brightest.
    levels = grey_in_255ths(np.concatenate([array[..., k] for k in range(3)], axis=1)).grey
    red, green, blue = np.split(_light(levels, bend), 3, axis=1)
    return (green + (red + blue)) / np.float32(3)


def light_of_white(white: float, bend: float) -> float:
    """The light of the largest level that can be told from a larger one, in 255ths."""
    return float(_light(np.full((1, 1), white), bend)[0, 0]) if np.isfinite(white) else white


@in_float64
def _light(grey: Float[np.ndarray, "h w"], bend: float) -> np.ndarray:
    brightest = max(float(grey.max()) / 255, 1.0)
    knots = np.linspace(0.0, brightest, round(_KNOTS * brightest) + 1)
    light = np.asarray(jax.vmap(light_of_level, (0, None))(knots, np.asarray(bend)))
    return np.interp(grey.ravel(), 255 * knots, 255 * light).reshape(grey.shape).astype(np.float32)


def grey_in_255ths(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """`numerics.grey_image` with full white at 255, whatever the picture's own range.

    Raises InputError for what is no picture.
    """
    found = grey_image(image)
    if found.full == 255:
        return found
    per_255th = found.full / 255
    return GreyImage(
        found.grey * np.float32(1 / per_255th),
        found.quantum / per_255th,
        found.white / per_255th,
        255.0,
    )
