"""The gradient of a picture at one scale, and what noise makes of it."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image import Light

# Standard deviation of the smoothing, px: with the blur of usual pictures the profile of an edge is
# some 1.5 px wide.
SMOOTHING_PX = 1.2
_HALF = 5


class Gradient(NamedTuple):
    """Fields
    ------
    by_uv : (2, h, w) derivative along u and along v, grey levels per px.
    noise : standard deviation of either, between pixels, from white noise in the picture.
    """

    by_uv: Float[np.ndarray, "2 h w"]
    noise: float


def gradient_of(picture: Shaped[np.ndarray, "..."]) -> Gradient:
    """Gaussian derivatives of the grey levels, in 255ths of full white.

    Raises InputError for what is no picture.
    """
    light = Light.from_picture(picture)
    smooth, slope = _kernels()
    border = cv2.BORDER_REPLICATE
    along_u = cv2.sepFilter2D(light.light, cv2.CV_32F, slope, smooth, borderType=border)
    along_v = cv2.sepFilter2D(light.light, cv2.CV_32F, smooth, slope, borderType=border)
    gain = np.sqrt((smooth**2).sum() * (slope**2).sum() * _between(smooth) * _between(slope))
    # A quarter of the pixels tell it to a percent.
    noise = light.noise_sigma(stride=(2, 2))
    return Gradient(np.stack([along_u, along_v]), float(noise * gain))


def _between(kernel: np.ndarray) -> float:
    """What interpolation leaves of the variance, on the mean of all places between pixels."""
    shared = (kernel[1:] * kernel[:-1]).sum() / (kernel**2).sum()
    return float((2 + shared) / 3)


def _kernels() -> tuple[np.ndarray, np.ndarray]:
    """(smoothing, derivative), for correlation; a ramp of one level per px answers with one."""
    at = np.arange(-_HALF, _HALF + 1)
    smooth = np.exp(-0.5 * (at / SMOOTHING_PX) ** 2)
    smooth /= smooth.sum()
    slope = at * smooth
    return smooth, slope / (slope * at).sum()
