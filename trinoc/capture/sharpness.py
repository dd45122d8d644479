"""How wide the edges of a picture are, from its steps seen through two scales."""

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.image import blur_of_two_slopes

# In pixels. The first is wide enough against noise, the second twice as wide.
_FINE, _COARSE = 1.0, 2.0
# Edges looked at: slopes along a ridge, above this share of the steepest ones.
_LEAST_SHARE = 0.4
_STEEP_PERCENTILE = 99.9
_FEWEST_EDGES = 20


def edge_blur_px(grey: Float[np.ndarray, "h w"]) -> float:
    """Median Gaussian sigma of the steep edges, in pixels; NaN where there are hardly any.

    A sensor's square pixels count for 0.29 px of it, motion for its part across each edge.
    """
    level = np.asarray(grey, dtype=np.float32)
    fine, coarse = _slope(level, _FINE), _slope(level, _COARSE)
    # Of flat paper nothing is left but noise, of which no ratio is taken.
    steep = _LEAST_SHARE * float(np.percentile(fine, _STEEP_PERCENTILE))
    ridge = (fine >= cv2.dilate(fine, np.ones((3, 3), np.uint8)) * 0.98) & (fine > max(steep, 1e-6))
    margin = int(np.ceil(3 * _COARSE))
    ridge[:margin] = ridge[-margin:] = False
    ridge[:, :margin] = ridge[:, -margin:] = False
    if np.count_nonzero(ridge) < _FEWEST_EDGES:
        return float("nan")
    squared_ratio = np.median((fine[ridge] / np.maximum(coarse[ridge], 1e-9)) ** 2)
    return blur_of_two_slopes(float(squared_ratio), _FINE, _COARSE)


def _slope(level: Float[np.ndarray, "h w"], scale: float) -> Float[np.ndarray, "h w"]:
    """Size of the gradient after a Gaussian, of which central differences are 1/3 px^2."""
    smooth = cv2.GaussianBlur(level, (0, 0), np.sqrt(scale**2 - 1.0 / 3.0))
    rows = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, ksize=1)
    columns = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, ksize=1)
    return cv2.magnitude(columns, rows)
