"""The six 5 x 5 edge masks of Nevatia and Babu, and their combination into one gradient.

Each mask answers best to a step edge of one direction; its sign tells the side that is
brighter, so that six masks tell twelve directions. `gradient_of` correlates a picture with it.
"""

import functools
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

MASK_ANGLES_DEG = (0, 30, 60, 90, 120, 150)
_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)
_BORDER = cv2.BORDER_REPLICATE

_MASKS = """
100 100 100 100 100 | 100 100 100 100 100 | 0 0 0 0 0 | -100 -100 -100 -100 -100 | -100 -100 -100 -100 -100
100 100 100 100 100 | 100 100 100 78 -32 | 100 92 0 -92 -100 | 32 -78 -100 -100 -100 | -100 -100 -100 -100 -100
100 100 100 32 -100 | 100 100 92 -78 -100 | 100 100 0 -100 -100 | 100 78 -92 -100 -100 | 100 -32 -100 -100 -100
-100 -100 0 100 100 | -100 -100 0 100 100 | -100 -100 0 100 100 | -100 -100 0 100 100 | -100 -100 0 100 100
-100 32 100 100 100 | -100 -78 92 100 100 | -100 -100 0 100 100 | -100 -100 -92 78 100 | -100 -100 -100 -32 100
100 100 100 100 100 | -32 78 100 100 100 | -100 -92 0 92 100 | -100 -100 -100 -78 32 | -100 -100 -100 -100 -100
"""  # noqa: E501


class GradientKernel(NamedTuple):
    """What answers with the gradient along u and v, in grey levels per pixel: the picture is
    smoothed by (1, 2, 1) / 4 both ways, and correlated with two masks.

    Fields
    ------
    masks : (2, 5, 5), for correlation (not convolution).
    variance_px2 : variance of the smoothing that they imply; a blurred step seen through them
        has a profile of this variance plus that of the blur.
    noise_gain : standard deviation of either answer to white noise of unit deviation.
    slope_gain : variance of the slope of the profile across a straight edge, averaged over a
        unit of length, for white noise of unit deviation; it says how far noise moves an edge.
    """

    masks: Float[np.ndarray, "2 5 5"]
    variance_px2: float
    noise_gain: float
    slope_gain: float


def nevatia_babu_masks() -> Float[np.ndarray, "6 5 5"]:
    """The six masks, each scaled so that a step through its centre answers with its height.

    The scale differs between masks: the absolute sums of the published numbers are 2000 at 0
    and 90 degrees and 2204 at the oblique angles.
    """
    masks = np.array(
        [[row.split() for row in line.split("|")] for line in _MASKS.strip().splitlines()],
        dtype=np.float64,
    )
    return masks / np.abs(masks).sum(axis=(1, 2), keepdims=True) * 2


def mask_gradient_directions() -> Float[np.ndarray, "6 2"]:
    """Unit (u, v) toward the brighter side of the edge that each mask answers to.

    The edges run at the nominal angles, counted from +u toward the top of the picture. The
    published masks are bright above the edge, but right of it at 90 degrees and beyond.
    """
    edge = np.radians(MASK_ANGLES_DEG)
    bright_right = np.where(np.array(MASK_ANGLES_DEG) >= 90, 1.0, -1.0)
    return bright_right[:, None] * np.stack([np.sin(edge), np.cos(edge)], axis=-1)


@functools.cache
def combined_kernel() -> GradientKernel:
    """The six masks as one vector kernel, smoothed by (1, 2, 1) / 4.

    The answers of the masks, each times its own direction, add up to a vector that points
    across the edge at any angle: directions are no longer quantised to 30 degrees, and six
    correlations become two. The smoothing adds half a squared pixel of variance.
    """
    masks = np.einsum("mij,mc->cij", nevatia_babu_masks(), mask_gradient_directions())
    # A ramp of one grey level per pixel shall answer with one.
    masks = masks / (masks[0] * np.arange(-2, 3)).sum()
    whole, u = _smoothed(np.pad(masks[0], 2), cv2.CV_64F), np.arange(-4, 5)
    # Integrating the kernel across the edge turns u into u^2 / 2 and u^3 into u^4 / 4: the
    # variance of the implied smoothing is a third of the ratio of its third to first moment.
    variance = (whole * u**3).sum() / (3 * (whole * u).sum())
    # The average along the edge is the answer of the kernel collapsed along it.
    collapsed = np.pad(whole.sum(axis=0), 1)
    slope_gain = (np.square(collapsed[2:] - collapsed[:-2]) / 4).sum()
    noise_gain = np.sqrt((whole**2).sum())
    return GradientKernel(masks, float(variance), float(noise_gain), float(slope_gain))


def _smoothed(grey: np.ndarray, depth: int) -> np.ndarray:
    return cv2.sepFilter2D(grey, depth, _BINOMIAL, _BINOMIAL, borderType=_BORDER)


class Gradient(NamedTuple):
    """(h, w) gradient along u and v in grey levels per pixel, and its squared size."""

    u: Float[np.ndarray, "h w"]
    v: Float[np.ndarray, "h w"]
    squared: Float[np.ndarray, "h w"]


def gradient_of(grey: Float[np.ndarray, "h w"], kernel: GradientKernel) -> Gradient:
    """Correlate the picture with both kernels; beyond its border the picture continues level."""
    # Smoothing first and the small masks after costs half as much as one large kernel.
    smooth = _smoothed(grey, cv2.CV_32F)
    u, v = (
        cv2.filter2D(smooth, cv2.CV_32F, mask.astype(np.float32), borderType=_BORDER)
        for mask in kernel.masks
    )
    # Rounded as NumPy rounds the products of neighbours: on a plateau they are equal.
    squared = u * u
    squared += v * v
    return Gradient(u, v, squared)
