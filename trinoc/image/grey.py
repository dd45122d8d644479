"""Any picture as grey levels, the same for calibration, segments and users.

The grey level of a colour pixel is the mean of its red, green and blue. So it does not matter
whether a reader delivers RGB (imageio, Pillow, matplotlib) or BGR (OpenCV), and the noise is the
least that three channels of equal noise allow.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8

from trinoc.errors import InputError
from trinoc.image.noise import level_noise

SMALLEST_SIDE_PX = 16
# Cameras of 8, 10, 12, 14 and 16 bit.
FULL_WHITE = (255.0, 1023.0, 4095.0, 16383.0, 65535.0)
# Pictures of real numbers that were filtered or made overshoot their white by up to this factor.
_SLACK = 1.25
# A comb: so many rows by turns lighter and darker, by more than so many sigmas of the noise and
# 255ths of full white. Its share of the pixels, and how many times as many there are as along rows.
# Moved by a pixel between the fields, the demo's pictures have shares of .007 to .03 and none along
# rows. Of 15 pictures that scikit-image carries none has ten times as many down as along.
_COMB_ROWS, _COMB_SIGMAS, _COMB_LEVELS = 6, 6.0, 8.0
_COMB_SHARE, _COMB_RATIO = 0.002, 10
# A mosaic: colours that differ by so much of the mean level and so many sigmas, each beside what
# smooths all of them away. Pixels of one industrial camera differ by .012 in their gains, those of
# 100 other pictures by less, colours of a raw picture by .5.
_MOSAIC_SHARE, _MOSAIC_SIGMAS = 0.05, 6.0
_SMOOTH = np.array([0.25, 0.5, 0.25])


class GreyImage(NamedTuple):
    """A grey picture.

    Fields
    ------
    grey : (h, w) grey levels, on the scale of the picture's own numbers; of real numbers up to 1:
        times 255.
    quantum : step between two levels, 0 for real numbers.
    white : the largest level that can be told from a larger one; infinite where not known.
    full : the level of full white in the picture's own range: the least of 255, 1023, 4095, 16383
        and 65535 that holds all levels, and always 255 for uint8.
    """

    grey: Float[np.ndarray, "h w"]
    quantum: float
    white: float
    full: float

    @property
    def size_px(self) -> tuple[int, int]:
        """(width, height)."""
        return self.grey.shape[1], self.grey.shape[0]

    def in_255ths(self) -> "GreyImage":
        """The same with full white at 255, whatever the picture's own range."""
        if self.full == 255:
            return self
        per_255th = self.full / 255
        grey = self.grey * np.float32(1 / per_255th)
        return GreyImage(grey, self.quantum / per_255th, self.white / per_255th, 255.0)

    def as_8_bit(self) -> UInt8[np.ndarray, "h w"]:
        """The grey levels in 255ths of full white, whole numbers."""
        return np.clip(self.grey * (255 / self.full), 0, 255).astype(np.uint8)


def grey_image(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """Grey levels of an (h, w) or (h, w, channels) picture of whole or real numbers.

    One channel is grey, two are grey and alpha, three are colours in either order, four are
    colours and alpha. Raises InputError for what is no picture: other shapes and types, pictures
    under 16 pixels a side, values that are not finite.
    """
    if image is None or isinstance(image, str) or hasattr(image, "__fspath__"):
        given = "None" if image is None else f'the name "{image}"'
        raise InputError(
            f"The picture is {given}, but must be an array: read the file first, as by cv2.imread, "
            "and check that it was found."
        )
    array = np.asarray(image)
    if array.dtype == np.bool_:
        raise InputError(
            "The picture is of truth values, which have no grey levels: give the picture itself, "
            "or 255 times the mask as uint8 where black and white is meant."
        )
    if array.dtype.kind not in "uif":
        raise InputError(
            f"A picture of {array.dtype} holds no grey levels: give an array of numbers."
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
    whole = array.dtype.kind != "f"
    quantum = 1.0 if whole else 0.0
    planes = [array] if array.ndim == 2 else list(np.moveaxis(array, 2, 0))
    if channels < 3:
        grey = np.ascontiguousarray(planes[0], dtype=np.float32)
    else:
        red, green, blue = (plane.astype(np.float32) for plane in planes[:3])
        # In this order the sum is the same, to the last bit, with red and blue exchanged.
        grey = (green + (red + blue)) / np.float32(3)
        if whole and not (np.array_equal(red, green) and np.array_equal(green, blue)):
            quantum /= 3
    if not whole and not np.isfinite(grey.sum(dtype=np.float64)):
        raise InputError("The picture has values that are not finite: replace them first.")
    largest = 0.0 if array.dtype == np.uint8 else float(np.abs(grey).max())
    if not whole and largest <= _SLACK:
        grey, quantum, largest = grey * np.float32(255), 255 * quantum, 255.0
    full = _full_white(largest if whole else largest / _SLACK)
    return GreyImage(grey, quantum, _white(array.dtype, full), full)


def _full_white(largest: float) -> float:
    """Full white of the fewest bits, 8 to 16, that hold a level."""
    return next((full for full in FULL_WHITE if largest <= full), max(largest, FULL_WHITE[-1]))


def _white(dtype: np.dtype, full: float) -> float:
    """The last level below saturation, in 255ths as cameras that shift their bits deliver it."""
    return 254 / 255 * full if dtype in (np.uint8, np.uint16) else np.inf


def why_mixed(image: GreyImage) -> str | None:
    """That neighbouring pixels are of two moments or of several colours, and what to do about it;
    None where they are of one light."""
    return why_interlaced(image) or why_mosaic(image)


def why_mosaic(image: GreyImage) -> str | None:
    """That pixels are of several colours by turns, and what to do about it; None where not.

    A mosaic of colours that are alike in it, as under balanced light, is as good as grey.
    """
    steps = image.grey - cv2.sepFilter2D(image.grey, -1, _SMOOTH, _SMOOTH)
    means = [steps[row::2, column::2].mean() for row in (0, 1) for column in (0, 1)]
    noise = _MOSAIC_SIGMAS * steps.std() / np.sqrt(steps.size / len(means))
    if max(means) - min(means) <= max(_MOSAIC_SHARE * image.grey.mean(), noise):
        return None
    return (
        "Its pixels are of several colours by turns (a raw mosaic): turn it into colour or grey, "
        'or name the colours to `calibrate` (bayer="RGGB").'
    )


def why_interlaced(image: GreyImage) -> str | None:
    """That even and odd rows are of two moments, and what to do about it; None where they are not.

    Edges that moved from one field to the next are combs of light and dark rows.
    """
    levels = image.in_255ths()
    most = _COMB_SHARE * levels.grey.size
    if _count_combs(levels.grey, _COMB_LEVELS) <= most:
        return None
    least = max(_COMB_SIGMAS * level_noise(levels.grey, levels.quantum), _COMB_LEVELS)
    down, along = (_count_combs(grey, least) for grey in (levels.grey, levels.grey.T))
    if down <= max(most, _COMB_RATIO * along):
        return None
    return (
        "Its even and odd rows are of two moments (interlaced), so that edges are combs: set the "
        "camera to whole frames (progressive), or hold still what it sees."
    )


def _count_combs(grey: Float[np.ndarray, "h w"], least: float) -> int:
    """Pixels above which so many steps down the rows go up and down by turns."""
    steps = np.diff(grey, axis=0)
    up, fall = ((side * steps > least).astype(np.uint8) for side in (1, -1))
    up[1::2], fall[1::2] = fall[1::2], up[1::2].copy()
    run = np.ones((_COMB_ROWS - 1, 1), np.uint8)
    return sum(cv2.countNonZero(cv2.erode(turns, run, borderValue=0)) for turns in (up, fall))
