"""Image as light: grey levels decoded by the camera response."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from trinoc.image.grey import GreyImage, grey_image
from trinoc.image.noise import level_noise
from trinoc.image.response import AbstractResponse, ResponseLike, find_response


class Light(NamedTuple):
    """An image as grey levels and as light, both in 255ths of full white.

    Attributes
    ----------
    levels : (h, w)
        Grey levels.
    light : (h, w)
        Light that the levels represent; the same array as `levels` for a linear response. For a
        colour image, the mean over the channels.
    quantum : float
        Step between two levels; 0 for real numbers.
    white : float
        Largest level below saturation; infinite if unknown.
    response : AbstractResponse
        Conversion between light and level.
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
        """Compute the light of an image: its grey levels decoded by the camera's response.

        Parameters
        ----------
        picture : (h, w) or (h, w, channels)
            Image, as in `grey_image`.
        response : str, float or AbstractResponse
            Response of the camera, as in `find_response`.

        Returns
        -------
        Light

        Raises
        ------
        InputError
            If the argument is not an image, or the response is unknown.
        """
        curve = find_response(response)
        image = grey_image(picture).in_255ths()
        light = image.grey if curve.is_linear else _read_light(np.asarray(picture), image, curve)
        return cls(image.grey, light, image.quantum, image.white, curve)

    @property
    def size_px(self) -> tuple[int, int]:
        """Size (width, height)."""
        return self.levels.shape[1], self.levels.shape[0]

    @property
    def is_linear(self) -> bool:
        """True if the light equals the levels."""
        return self.light is self.levels

    @property
    def light_of_white(self) -> float:
        """Light of the largest level below saturation; infinite if unknown."""
        if self.is_linear or not np.isfinite(self.white):
            return self.white
        return float(255 * self.response.light_of(self.white / 255))

    def noise_sigma(self, stride: tuple[int, int] = (1, 1)) -> float:
        """Standard deviation of the noise of the light in one pixel.

        Parameters
        ----------
        stride : (int, int)
            Only every n-th row and every m-th column are used.

        Returns
        -------
        float
            In 255ths of full white.
        """
        return level_noise(self.light, self.quantum if self.is_linear else 0.0, stride)

    def find_clipped(self, margin_px: int = 0) -> Bool[np.ndarray, "h w"]:
        """Mask of the saturated pixels and of the pixels around them, (h, w).

        Parameters
        ----------
        margin_px : int
            Number of pixels by which the mask is dilated.
        """
        saturated = (self.levels >= self.white).astype(np.uint8)
        side = 2 * margin_px + 1
        return cv2.dilate(saturated, np.ones((side, side), np.uint8)) > 0


def _read_light(
    picture: Shaped[np.ndarray, "..."], image: GreyImage, response: AbstractResponse
) -> Float[np.ndarray, "h w"]:
    if picture.ndim == 2 or picture.shape[2] < 3:
        return _decode_levels(image.grey, response)
    # Side by side, the channels are one grey picture: all have the range of the brightest.
    channels = np.concatenate([picture[..., k] for k in range(3)], axis=1)
    light = _decode_levels(grey_image(channels).in_255ths().grey, response)
    red, green, blue = np.split(light, 3, axis=1)
    return (green + (red + blue)) / np.float32(3)


def _decode_levels(
    levels: Float[np.ndarray, "h w"], response: AbstractResponse
) -> Float[np.ndarray, "h w"]:
    return np.asarray(255 * response.light_of(levels / np.float32(255)), dtype=np.float32)
