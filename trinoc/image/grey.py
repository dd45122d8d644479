"""Grey levels of any image, the same for calibration, segments and users.

The grey level of a colour pixel is the mean of red, green and blue. So the order of the channels
does not matter: RGB (imageio, Pillow, matplotlib) or BGR (OpenCV). For equal noise in the channels,
the mean also has the least noise.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8

from trinoc.errors import InputError
from trinoc.image.noise import level_noise

SMALLEST_SIDE_PX = 16
# Full white of cameras with 8, 10, 12, 14 and 16 bit.
FULL_WHITE = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
# Filtered or rendered images of real numbers may exceed full white by up to this factor.
_SLACK = 1.25
# A comb: number of rows that alternate in brightness; smallest step, in sigmas of the noise and in
# 255ths of full white. Interlaced: smallest share of comb pixels, and smallest ratio to those of
# the transposed image. With a shift of one pixel between the fields, the demo's images have shares
# of .007 to .03, and none when transposed. No image of scikit-image (15) has a ratio of ten.
_COMB_ROWS, _COMB_SIGMAS, _COMB_LEVELS = 6, 6.0, 8.0
_COMB_SHARE, _COMB_RATIO = 0.002, 10
# A mosaic: smallest difference of the colours from the smoothed image, as a share of the mean level
# and in sigmas. The pixel gains of an industrial camera differ by .012, those of 100 other images
# by less, the colours of a raw image by .5.
_MOSAIC_SHARE, _MOSAIC_SIGMAS = 0.05, 6.0
_SMOOTH = np.array([0.25, 0.5, 0.25])


class GreyImage(NamedTuple):
    """A grey image with its white level.

    Attributes
    ----------
    grey : (h, w)
        Grey levels, on the scale of the input. Real numbers up to 1 are multiplied by 255.
    quantum : float
        Step between two levels; 0 for real numbers.
    white : float
        Largest level below saturation; infinite if unknown.
    full : float
        Level of full white: the smallest of 255, 1023, 4095, 16383 and 65535 that no level exceeds.
        Always 255 for uint8.
    """

    grey: Float[np.ndarray, "h w"]
    quantum: float
    white: float
    full: float

    @property
    def size_px(self) -> tuple[int, int]:
        """Size (width, height)."""
        return self.grey.shape[1], self.grey.shape[0]

    def in_255ths(self) -> "GreyImage":
        """Copy of the image with levels scaled so that full white is 255."""
        if self.full == 255:
            return self
        per_255th = self.full / 255
        grey = self.grey * np.float32(1 / per_255th)
        return GreyImage(grey, self.quantum / per_255th, self.white / per_255th, 255.0)

    def as_8_bit(self) -> UInt8[np.ndarray, "h w"]:
        """Grey levels, (h, w), scaled so that full white is 255 and truncated to uint8."""
        return np.clip(self.grey * (255 / self.full), 0, 255).astype(np.uint8)


def grey_image(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """Convert an image of integers or real numbers to grey levels.

    Parameters
    ----------
    image : (h, w) or (h, w, channels)
        One channel: grey. Two channels: grey and alpha. Three channels: red, green and blue in
        either order. Four channels: colours and alpha. Alpha is ignored.

    Returns
    -------
    GreyImage
        The mean of the three colours is the grey level.

    Raises
    ------
    InputError
        If the argument is not an image: wrong shape or type, less than 16 pixels per side, or
        values that are not finite.
    """
    if image is None or isinstance(image, str) or hasattr(image, "__fspath__"):
        argument = "None" if image is None else f'the name "{image}"'
        raise InputError(
            f"The picture is {argument}, but must be an array. Read the file first, for example "
            "with cv2.imread, and check that the file exists."
        )
    array = np.asarray(image)
    if array.dtype == np.bool_:
        raise InputError(
            "The picture has truth values, not grey levels. Give the picture itself, or 255 times "
            "the mask as uint8 for a black and white picture."
        )
    if array.dtype.kind not in "uif":
        raise InputError(
            f"A picture of type {array.dtype} has no grey levels. Give an array of numbers."
        )
    channels = array.shape[2] if array.ndim == 3 else 1
    if array.ndim not in (2, 3) or not 1 <= channels <= 4:
        raise InputError(
            f"The picture has shape {array.shape}, but must be (height, width) or "
            "(height, width, 3)."
        )
    if min(array.shape[:2]) < SMALLEST_SIDE_PX:
        raise InputError(
            f"The picture is {array.shape[1]} x {array.shape[0]} px, but must have at least "
            f"{SMALLEST_SIDE_PX} px a side."
        )
    is_integer = array.dtype.kind != "f"
    quantum = 1.0 if is_integer else 0.0
    planes = [array] if array.ndim == 2 else list(np.moveaxis(array, 2, 0))
    if channels < 3:
        grey = np.ascontiguousarray(planes[0], dtype=np.float32)
    else:
        red, green, blue = (plane.astype(np.float32) for plane in planes[:3])
        # In this order the sum is the same, to the last bit, with red and blue exchanged.
        grey = (green + (red + blue)) / np.float32(3)
        if is_integer and not (np.array_equal(red, green) and np.array_equal(green, blue)):
            quantum /= 3
    if not is_integer and not np.isfinite(grey.sum(dtype=np.float64)):
        raise InputError("The picture has values that are not finite. Replace them first.")
    largest = 0.0 if array.dtype == np.uint8 else float(np.abs(grey).max())
    if not is_integer and largest <= _SLACK:
        grey, quantum, largest = grey * np.float32(255), 255 * quantum, 255.0
    full = _full_white(largest if is_integer else largest / _SLACK)
    return GreyImage(grey, quantum, _white(array.dtype, full), full)


def _full_white(largest: float) -> float:
    """Smallest level of full white (8 to 16 bit) that is not below the level `largest`."""
    return next((full for full in FULL_WHITE if largest <= full), max(largest, FULL_WHITE[-1]))


def _white(dtype: np.dtype, full: float) -> float:
    """Largest level below saturation: full white minus 1/255 of it.

    With this limit, saturation is also detected in images whose bits were shifted by the camera.
    Infinity for other types than 8 and 16 bit integers.
    """
    return 254 / 255 * full if dtype in (np.uint8, np.uint16) else np.inf


def describe_mixed_pixels(image: GreyImage) -> str | None:
    """Return a message if an image is interlaced or a raw mosaic, with the remedy; else None.

    Parameters
    ----------
    image : GreyImage
        The image.
    """
    return describe_interlacing(image) or describe_mosaic(image)


def describe_mosaic(image: GreyImage) -> str | None:
    """Return a message if an image is a raw colour mosaic, with the remedy; else None.

    A mosaic whose colours have equal mean levels, for example under balanced light, is not
    reported, because it can be used like a grey image.

    Parameters
    ----------
    image : GreyImage
        The image.
    """
    steps = image.grey - cv2.sepFilter2D(image.grey, -1, _SMOOTH, _SMOOTH)
    means = [steps[row::2, column::2].mean() for row in (0, 1) for column in (0, 1)]
    noise = _MOSAIC_SIGMAS * steps.std() / np.sqrt(steps.size / len(means))
    if max(means) - min(means) <= max(_MOSAIC_SHARE * image.grey.mean(), noise):
        return None
    return (
        "Neighbouring pixels have different colours (a raw mosaic). Convert it to colour or grey, "
        'or give the pattern of colours to `calibrate` (bayer="RGGB").'
    )


def describe_interlacing(image: GreyImage) -> str | None:
    """Return a message if an image is interlaced, with the remedy; else None.

    In an interlaced image, even and odd rows are from two moments. Moving edges then look like
    combs of light and dark rows.

    Parameters
    ----------
    image : GreyImage
        The image.
    """
    levels = image.in_255ths()
    most_combs = _COMB_SHARE * levels.grey.size
    if _count_combs(levels.grey, _COMB_LEVELS) <= most_combs:
        return None
    smallest_step = max(_COMB_SIGMAS * level_noise(levels.grey, levels.quantum), _COMB_LEVELS)
    down, along = (_count_combs(grey, smallest_step) for grey in (levels.grey, levels.grey.T))
    if down <= max(most_combs, _COMB_RATIO * along):
        return None
    return (
        "Even and odd rows were taken at two times (interlaced), so edges look like combs. Set the "
        "camera to progressive scan, or keep the scene still."
    )


def _count_combs(grey: Float[np.ndarray, "h w"], smallest_step: float) -> int:
    """Number of pixels at which a column of alternating light and dark rows begins.

    `smallest_step` is the smallest difference of neighbouring rows, grey levels.
    """
    steps = np.diff(grey, axis=0)
    up, fall = ((side * steps > smallest_step).astype(np.uint8) for side in (1, -1))
    up[1::2], fall[1::2] = fall[1::2], up[1::2].copy()
    run = np.ones((_COMB_ROWS - 1, 1), np.uint8)
    return sum(cv2.countNonZero(cv2.erode(turns, run, borderValue=0)) for turns in (up, fall))
