"""Gradient of an image by the six 5 x 5 masks of Nevatia and Babu.

Each mask responds most to a step edge of one direction; the sign gives the brighter side. So six
masks distinguish twelve directions. `correlate_gradient` correlates an image with all of them at
once.
"""

import functools
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

# numerical: of the published masks.
MASK_ANGLES_DEG = (0, 30, 60, 90, 120, 150)


_BINOMIAL = np.array([0.25, 0.5, 0.25], np.float32)  # numerical: the least smoothing


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
    """Kernel for the gradient of an image along u and v, grey levels per px.

    The image is smoothed by (1, 2, 1) / 4 along both axes, then correlated with two masks.

    Attributes
    ----------
    masks : (2, 5, 5)
        Masks for u and for v, for correlation (not convolution).
    variance_px2 : float
        Variance of the smoothing. The variance of the gradient profile across a blurred step is
        this variance plus the variance of the blur.
    noise_gain : float
        Standard deviation of each gradient component for white noise with standard deviation 1.
    slope_gain : float
        Variance of the slope of the gradient profile across a straight edge, for white noise with
        standard deviation 1. The profile is averaged over a unit of the edge's length. This value
        determines how far noise shifts an edge.
    """

    masks: Float[np.ndarray, "2 5 5"]
    variance_px2: float
    noise_gain: float
    slope_gain: float


def nevatia_babu_masks() -> Float[np.ndarray, "6 5 5"]:
    """Return the six masks, scaled so that the response to a step through the centre is its height.

    Returns
    -------
    (6, 5, 5)
        Masks for edges at 0, 30, 60, 90, 120 and 150 degrees.

    Notes
    -----
    Each mask has its own scale. The absolute sums of the published numbers are 2000 at 0 and 90
    degrees, and 2204 at the oblique angles.
    """
    masks = np.array(
        [[row.split() for row in line.split("|")] for line in _MASKS.strip().splitlines()],
        dtype=np.float64,
    )
    return masks / np.abs(masks).sum(axis=(1, 2), keepdims=True) * 2


def mask_gradient_directions() -> Float[np.ndarray, "6 2"]:
    """Return the unit vector (u, v) toward the brighter side of the edge that each mask detects,
    (6, 2).

    The angles of the edges are measured from +u toward the top of the image. The published masks
    are bright above the edge for angles below 90 degrees, and bright on its right for the others.
    """
    edge = np.radians(MASK_ANGLES_DEG)
    bright_right = np.where(np.array(MASK_ANGLES_DEG) >= 90, 1.0, -1.0)
    return bright_right[:, None] * np.stack([np.sin(edge), np.cos(edge)], axis=-1)


@functools.cache
def combined_kernel() -> GradientKernel:
    """Combine the six masks to one gradient kernel, with smoothing by (1, 2, 1) / 4.

    The sum of the masks' responses, each times its direction, is a vector across the edge at any
    angle. Directions are therefore not quantised to 30 degrees, and two correlations replace six.
    The smoothing adds a variance of 0.5 px^2.
    """
    masks = np.einsum("mij,mc->cij", nevatia_babu_masks(), mask_gradient_directions())
    # The response to a ramp of one grey level per pixel is one.
    masks = masks / (masks[0] * np.arange(-2, 3)).sum()
    smoothed_mask, u = _smooth_picture(np.pad(masks[0], 2), cv2.CV_64F), np.arange(-4, 5)
    # Integrating the kernel across the edge turns u into u^2 / 2 and u^3 into u^4 / 4: the
    # variance of the implied smoothing is a third of the ratio of its third to first moment.
    variance = (smoothed_mask * u**3).sum() / (3 * (smoothed_mask * u).sum())
    # The average along the edge is the response of the kernel collapsed along it.
    collapsed = np.pad(smoothed_mask.sum(axis=0), 1)
    slope_gain = (np.square(collapsed[2:] - collapsed[:-2]) / 4).sum()
    noise_gain = np.sqrt((smoothed_mask**2).sum())
    return GradientKernel(masks, float(variance), float(noise_gain), float(slope_gain))


def _smooth_picture(grey: np.ndarray, depth: int) -> np.ndarray:
    return cv2.sepFilter2D(grey, depth, _BINOMIAL, _BINOMIAL, borderType=_BORDER)


class Gradient(NamedTuple):
    """Gradient of an image along u and v, grey levels per px, and its squared magnitude, (h, w)
    each.
    """

    u: Float[np.ndarray, "h w"]
    v: Float[np.ndarray, "h w"]
    squared: Float[np.ndarray, "h w"]


def correlate_gradient(grey: Float[np.ndarray, "h w"], kernel: GradientKernel) -> Gradient:
    """Compute the gradient of an image. Outside the image, border pixels are replicated."""
    # Smoothing followed by small masks costs half as much as one large kernel.
    smooth = _smooth_picture(grey, cv2.CV_32F)
    u, v = (
        cv2.filter2D(smooth, cv2.CV_32F, mask.astype(np.float32), borderType=_BORDER)
        for mask in kernel.masks
    )
    # Rounded like NumPy's products of neighbours, so that pixels of a plateau are equal.
    squared = u * u
    squared += v * v
    return Gradient(u, v, squared)
