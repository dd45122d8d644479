"""Colour from a mosaic: the channels that a pixel did not see, from its neighbours."""

from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.synth.camera_picture.sensor import BLACK, Mosaic, gain_of_pixels

Interpolation = Literal["bilinear", "edge-aware"]

_CODES = {
    "bilinear": cv2.COLOR_BayerRGGB2RGB,
    "edge-aware": cv2.COLOR_BayerRGGB2RGB_EA,
}
_FULL = 65535.0


def demosaiced(
    signal: Float[np.ndarray, "h w"], mosaic: Mosaic, interpolation: Interpolation
) -> Float[np.ndarray, "h w 3"]:
    """Red, green and blue of each pixel, balanced so that white has equal parts.

    Balanced pixels are saturated where they pass 1. OpenCV interpolates 16-bit numbers.
    """
    balanced = np.minimum(signal / gain_of_pixels(mosaic, signal.shape), 1.0)
    # Where a gain is small, noise reaches further below black than the read-out does.
    black = BLACK / min(mosaic.gains)
    raw = np.rint((balanced + black) / (1 + black) * _FULL).astype(np.uint16)
    colour = cv2.cvtColor(raw, _CODES[interpolation]).astype(np.float64) / _FULL
    return colour * (1 + black) - black
