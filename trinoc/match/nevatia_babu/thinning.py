"""Edge points: pixels whose gradient is largest across the edge, located to sub-pixels.

Nevatia and Babu keep a pixel when its magnitude exceeds the magnitudes of its two neighbours
across the edge, and those neighbours point about the same way. Both conditions are one here:
the neighbours' gradients are projected on the pixel's own direction before comparison.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.nevatia_babu.gradient import Gradient

# Linking looks two pixels to each side.
BORDER_PX = 2
_SMALLEST = 1e-6


class EdgePoints(NamedTuple):
    """Points of edges, one per pixel at most.

    Fields
    ------
    pixel : (n,) index of the pixel in the flattened picture, increasing.
    uv_px : (n, 2) position to sub-pixels.
    normal : (n, 2) unit vector across the edge, toward the brighter side.
    strength : (n,) size of the gradient, in grey levels per pixel.
    variance_px2 : (n,) variance of the gradient's profile across the edge: that of the kernel
        plus that of the edge's own blur.
    """

    pixel: Int[np.ndarray, "n"]
    uv_px: Float[np.ndarray, "n 2"]
    normal: Float[np.ndarray, "n 2"]
    strength: Float[np.ndarray, "n"]
    variance_px2: Float[np.ndarray, "n"]

    def select(self, which: np.ndarray) -> "EdgePoints":
        """The points at the given indices, in that order, or where the mask is true."""
        return EdgePoints(*(field[which] for field in self))

    @property
    def direction(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) along the edge, with the darker side on the right as seen on the picture."""
        return np.stack([-self.normal[:, 1], self.normal[:, 0]], axis=-1)


def edge_points(gradient: Gradient, least_strength: float) -> EdgePoints:
    """Thin the gradient to edge points of at least the given strength.

    The neighbours are taken along the picture axis that is nearer to the gradient, where
    samples need no interpolation. A Gaussian profile cut at a slant is again Gaussian, so the
    parabola through the logarithms of the three samples gives position and width exactly
    where blur and kernel are Gaussian.
    """
    width = gradient.u.shape[1]
    strong = gradient.squared > np.float32(least_strength**2)
    strong[:BORDER_PX] = strong[-BORDER_PX:] = False
    strong[:, :BORDER_PX] = strong[:, -BORDER_PX:] = False
    pixel = np.flatnonzero(strong)
    u, v = gradient.u.ravel(), gradient.v.ravel()
    gu, gv = u[pixel], v[pixel]
    along_u = np.abs(gu) >= np.abs(gv)
    step = np.where(along_u, 1, width)
    centre = gu * gu + gv * gv
    before = gu * u[pixel - step] + gv * v[pixel - step]
    after = gu * u[pixel + step] + gv * v[pixel + step]
    # One of the two comparisons admits equality, or a plateau of two would lose both.
    peak = np.flatnonzero((centre > before) & (centre >= after))

    pixel, along_u, gu, gv = pixel[peak], along_u[peak], gu[peak], gv[peak]
    squared = centre[peak]
    low = np.log(np.maximum(before[peak] / squared, _SMALLEST))
    high = np.log(np.maximum(after[peak] / squared, _SMALLEST))
    curvature = np.minimum(low + high, -_SMALLEST)
    offset = 0.5 * (low - high) / curvature
    strength = np.sqrt(squared)
    normal = np.stack([gu, gv], axis=-1) / strength[:, None]
    larger = np.where(along_u, normal[:, 0], normal[:, 1])
    row, column = np.divmod(pixel, width)
    uv_px = np.stack([column + offset * along_u, row + offset * ~along_u], axis=-1)
    return EdgePoints(
        pixel, uv_px.astype(np.float32), normal, strength, -larger * larger / curvature
    )
