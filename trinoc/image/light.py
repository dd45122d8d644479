"""A picture as the light that its grey levels stand for."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.image.grey import GreyImage, grey_image
from trinoc.image.noise import level_noise
from trinoc.image.response import AbstractResponse, ResponseLike, find_response


class Light(NamedTuple):
    """Levels and light of a picture on one scale for all pictures, so that a contrast means the
    same in each: in 255ths of full white.

    Fields
    ------
    levels : (h, w) grey levels.
    light : (h, w) the light that they stand for; `levels` itself where the response is linear. Of
        a colour, the mean of its channels' light.
    quantum : step between two levels, 0 for real numbers.
    white : the largest level that can be told from a larger one; infinite where not known.
    response : how the camera makes levels of light.
    """

    levels: Float[np.ndarray, "h w"]
    light: Float[np.ndarray, "h w"]
    quantum: float
    white: float
    response: AbstractResponse

    @classmethod
    def from_picture(
        cls, picture: Shaped[np.ndarray, "..."], response: ResponseLike = "linear"
    ) -> "Light":
        """The light of an (h, w) or (h, w, channels) picture.

        Raises InputError for what is no picture, and for an unknown response.
        """
        curve = find_response(response)
        given = grey_image(picture).in_255ths()
        light = given.grey if curve.is_linear else _read_light(np.asarray(picture), given, curve)
        return cls(given.grey, light, given.quantum, given.white, curve)

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.levels.shape[1], self.levels.shape[0]

    @property
    def is_linear(self) -> bool:
        """Whether the light is the levels themselves."""
        return self.light is self.levels

    @property
    def light_of_white(self) -> float:
        """The light of the largest level that can be told from a larger one."""
        if self.is_linear or not np.isfinite(self.white):
            return self.white
        return float(255 * self.response.light_of(self.white / 255))

    def noise_sigma(self, stride: tuple[int, int] = (1, 1)) -> float:
        """Standard deviation of the light between pixels, from every so many rows and columns."""
        return level_noise(self.light, self.quantum if self.is_linear else 0.0, stride)

    def find_clipped(self, beside_px: int = 0) -> Bool[np.ndarray, "h w"]:
        """(h, w) whether a pixel is saturated, or so near to one that is."""
        saturated = (self.levels >= self.white).astype(np.uint8)
        side = 2 * beside_px + 1
        return cv2.dilate(saturated, np.ones((side, side), np.uint8)) > 0


def _read_light(
    picture: Shaped[np.ndarray, "..."], given: GreyImage, response: AbstractResponse
) -> Float[np.ndarray, "h w"]:
    if picture.ndim == 2 or picture.shape[2] < 3:
        return _decode_levels(given.grey, response)
    # Side by side, the channels are one grey picture: all have the range of the brightest.
    channels = np.concatenate([picture[..., k] for k in range(3)], axis=1)
    light = _decode_levels(grey_image(channels).in_255ths().grey, response)
    red, green, blue = np.split(light, 3, axis=1)
    return (green + (red + blue)) / np.float32(3)


def _decode_levels(
    levels: Float[np.ndarray, "h w"], response: AbstractResponse
) -> Float[np.ndarray, "h w"]:
    return np.asarray(255 * response.light_of(levels / np.float32(255)), dtype=np.float32)
