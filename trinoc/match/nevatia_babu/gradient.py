"""Gradient of a grey picture by the combined masks."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.match.nevatia_babu.masks import GradientKernel


class Gradient(NamedTuple):
    """(h, w) gradient along u and v in grey levels per pixel, and its squared size."""

    u: Float[np.ndarray, "h w"]
    v: Float[np.ndarray, "h w"]
    squared: Float[np.ndarray, "h w"]


def gradient_of(grey: Float[np.ndarray, "h w"], kernel: GradientKernel) -> Gradient:
    """Correlate the picture with both kernels; beyond its border the picture continues level."""
    u = cv2.filter2D(grey, cv2.CV_32F, kernel.u.astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    v = cv2.filter2D(grey, cv2.CV_32F, kernel.v.astype(np.float32), borderType=cv2.BORDER_REPLICATE)
    # In place: fresh memory costs more than the arithmetic on it.
    squared = u * u
    cv2.accumulateSquare(v, squared)
    return Gradient(u, v, squared)
