"""Any picture as grey levels in single precision."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from trinoc.errors import InputError

_LEAST_SIDE_PX = 16


class GreyImage(NamedTuple):
    """A grey picture.

    Fields
    ------
    grey : (h, w) grey levels on the scale of 0 to 255 for whole-number pictures; pictures of
        real numbers keep their scale.
    quantum : step between two levels, 0 for real numbers.
    white : the level of saturation; infinite for real numbers.
    """

    grey: Float[np.ndarray, "h w"]
    quantum: float
    white: float


def grey_image(image: Shaped[np.ndarray, "..."]) -> GreyImage:
    """Grey levels of an (h, w) or (h, w, 3 or 4) picture of uint8, uint16 or real numbers.

    Colours are taken in the order red, green, blue and weighted as in ITU-R BT.601; a fourth
    channel is ignored. Raises InputError for other shapes and types, for pictures under 16
    pixels a side and for values that are not finite.
    """
    image = np.asarray(image)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] not in (3, 4)):
        raise InputError(
            f"The picture has shape {image.shape}, but must be (height, width) or "
            "(height, width, 3)."
        )
    if min(image.shape[:2]) < _LEAST_SIDE_PX:
        raise InputError(
            f"The picture is {image.shape[1]} x {image.shape[0]} px, but must have at least "
            f"{_LEAST_SIDE_PX} px a side."
        )
    if image.dtype == np.uint8:
        scale, quantum, white = 1.0, 1.0, 254.0
    elif image.dtype == np.uint16:
        scale, quantum, white = 1 / 257, 1 / 257, 254.0
    elif np.issubdtype(image.dtype, np.floating):
        scale, quantum, white = 1.0, 0.0, np.inf
        if not np.isfinite(image).all():
            raise InputError(
                "The picture has values that are not finite: replace them before searching "
                "for segments."
            )
    else:
        raise InputError(
            f"The picture is of type {image.dtype}, but must be uint8, uint16 or real numbers."
        )
    if image.ndim == 3:
        image = cv2.cvtColor(
            np.ascontiguousarray(image[:, :, :3], dtype=np.float32), cv2.COLOR_RGB2GRAY
        )
    grey = image.astype(np.float32)
    if scale != 1.0:
        grey *= np.float32(scale)
    return GreyImage(grey, quantum, white)
