"""Thinning: pixels whose gradient is largest across the edge.

Nevatia and Babu keep a pixel when its magnitude exceeds the magnitudes of its two neighbours
across the edge, and those neighbours point about the same way. Both conditions are one here:
the neighbours' gradients are projected on the pixel's own direction before comparison.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.segments.nevatia_babu.gradient import Gradient

# Linking looks two pixels to each side.
BORDER_PX = 2
_SMALLEST = np.float32(1e-6)


class ThinnedPixels(NamedTuple):
    """Pixels on edges; lengths are in pixels of the level they belong to.

    Fields
    ------
    pixel : (n,) index of the pixel in the flattened picture.
    gradient : (n, 2) toward the brighter side, in grey levels per pixel.
    along_u : (n,) whether u is the axis nearer to the gradient, or else v.
    profile : (n, 3) gradient along the pixel's own direction at the pixel before, at and after
        it along that axis.
    uv_px : (n, 2) peak of the profile, to sub-pixels.
    """

    pixel: Int[np.ndarray, "n"]
    gradient: Float[np.ndarray, "n 2"]
    along_u: Bool[np.ndarray, "n"]
    profile: Float[np.ndarray, "n 3"]
    uv_px: Float[np.ndarray, "n 2"]

    def take(self, which: np.ndarray) -> "ThinnedPixels":
        """The pixels at the given indices, in that order."""
        return ThinnedPixels(*(np.take(field, which, axis=0) for field in self))

    @property
    def direction(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) unit vector along the edge, with the darker side on the right."""
        return self.gradient[:, ::-1] * np.array([-1, 1], np.float32) / self.profile[:, 1:2]


def thinned_pixels(
    gradient: Gradient,
    least_strength: float,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> ThinnedPixels:
    """Pixels with a gradient of at least `least_strength` that is largest across the edge.

    The neighbours are taken along the axis of the picture that is nearer to the gradient,
    where samples need no interpolation. Pixels that are `excluded` are left out.
    """
    width = gradient.u.shape[1]
    strong = gradient.squared > np.float32(least_strength**2)
    if excluded is not None:
        strong &= ~excluded
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

    pixel, along_u = pixel[peak], along_u[peak]
    size = np.sqrt(centre[peak])
    profile = np.stack([before[peak] / size, size, after[peak] / size], axis=-1)
    row, column = np.divmod(pixel, width)
    uv_px = np.stack([column, row], axis=-1).astype(np.float32)
    offset, _ = peak_of_profile(profile)
    uv_px[:, 0] += offset * along_u
    uv_px[:, 1] += offset * ~along_u
    return ThinnedPixels(pixel, np.stack([gu[peak], gv[peak]], axis=-1), along_u, profile, uv_px)


def profile_across(gradient: Gradient, pixels: ThinnedPixels) -> Float[np.ndarray, "n 5"]:
    """(n, 5) another gradient of the same picture across the same edges: along each pixel's own
    direction, at the pixel, the two before and the two after it."""
    normal = pixels.gradient / pixels.profile[:, 1:2]
    step = np.where(pixels.along_u, 1, gradient.u.shape[1])
    u, v = gradient.u.ravel(), gradient.v.ravel()
    near = (pixels.pixel + sign * step for sign in range(-BORDER_PX, BORDER_PX + 1))
    return np.stack([normal[:, 0] * u[at] + normal[:, 1] * v[at] for at in near], axis=-1)


def peak_of_profile(
    profile: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """(offset, variance) of the Gaussian through three samples, one apart.

    The offset counts from the middle sample. A Gaussian cut at a slant is again Gaussian: the
    parabola through the logarithms of three samples along an axis of the picture gives peak
    and width across the edge exactly where blur and kernel are Gaussian.
    """
    level = np.log(np.maximum(profile, _SMALLEST))
    low, high = level[:, 0] - level[:, 1], level[:, 2] - level[:, 1]
    curvature = np.minimum(low + high, -_SMALLEST)
    return (low - high) / (2 * curvature), -1 / curvature
