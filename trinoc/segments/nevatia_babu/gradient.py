"""Gradient of a grey picture by the combined masks."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.segments.nevatia_babu.masks import GradientKernel

_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)
_BORDER = cv2.BORDER_REPLICATE


class Gradient(NamedTuple):
    """(h, w) gradient along u and v in grey levels per pixel, and its squared size."""

    u: Float[np.ndarray, "h w"]
    v: Float[np.ndarray, "h w"]
    squared: Float[np.ndarray, "h w"]


def gradient_of(grey: Float[np.ndarray, "h w"], kernel: GradientKernel) -> Gradient:
    """Correlate the picture with both kernels; beyond its border the picture continues level."""
    # Smoothing first and the small masks after costs half as much as one large kernel.
    smooth = grey
    for _ in range(kernel.smoothing):
        smooth = cv2.sepFilter2D(smooth, cv2.CV_32F, _BINOMIAL, _BINOMIAL, borderType=_BORDER)
    u = cv2.filter2D(smooth, cv2.CV_32F, kernel.mask_u.astype(np.float32), borderType=_BORDER)
    v = cv2.filter2D(smooth, cv2.CV_32F, kernel.mask_v.astype(np.float32), borderType=_BORDER)
    # Rounded as NumPy rounds the products of neighbours: on a plateau they are equal.
    squared = u * u
    squared += v * v
    return Gradient(u, v, squared)
