"""Thinning: pixels whose gradient is largest across the edge.

Nevatia and Babu keep a pixel when its magnitude exceeds the magnitudes of its two neighbours
across the edge, and those neighbours point about the same way. Both conditions are one here:
the neighbours' gradients are projected on the pixel's own direction before comparison.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image import peak_of_slope
from trinoc.segments.nevatia_babu.masks import Gradient, GradientKernel, gradient_of

# Linking looks two pixels to each side.
BORDER_PX = 2
# Pixels that are worked on at a time; rows that smoothing and masks look beyond their own.
_STRIP_PX, _HALO_PX = 1 << 16, 3


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
    grey: Float[np.ndarray, "h w"],
    kernel: GradientKernel,
    least_strength: float,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> ThinnedPixels:
    """Pixels of a picture with a gradient of at least `least_strength` that is largest across.

    The neighbours are taken along the axis of the picture that is nearer to the gradient,
    where samples need no interpolation. Pixels that are `excluded` are left out.
    """
    height, width = grey.shape
    # Strip by strip: what a strip needs stays in the processor's cache.
    rows = max(_STRIP_PX // width, 2 * _HALO_PX)
    strips: list[ThinnedPixels] = []
    for top in range(BORDER_PX, height - BORDER_PX, rows):
        bottom = min(top + rows, height - BORDER_PX)
        above = max(top - 1 - _HALO_PX, 0)
        gradient = gradient_of(grey[above : bottom + 1 + _HALO_PX], kernel)
        seen = slice(top - 1 - above, bottom + 1 - above)
        free = None if excluded is None else ~excluded[top:bottom]
        strips.append(
            _peaks(Gradient(*(part[seen] for part in gradient)), top, least_strength, free)
        )
    return ThinnedPixels(*(np.concatenate(field) for field in zip(*strips, strict=True)))


def _peaks(
    gradient: Gradient,
    top: int,
    least_strength: float,
    free: Bool[np.ndarray, "_h w"] | None,
) -> ThinnedPixels:
    """Thinned pixels of a strip, of which one row more is given on either side.

    The strip begins at row `top` of the picture.
    """
    width = gradient.u.shape[1]
    strong = gradient.squared > np.float32(least_strength**2)
    strong[0] = strong[-1] = False
    strong[:, :BORDER_PX] = strong[:, -BORDER_PX:] = False
    if free is not None:
        strong[1:-1] &= free
    u, v, squared = (part.ravel() for part in gradient)
    pixel = np.flatnonzero(strong)
    gu, gv, centre = np.take(u, pixel), np.take(v, pixel), np.take(squared, pixel)
    along_u = np.abs(gu) >= np.abs(gv)
    # width where along v, and 1 where along u.
    step = width - (width - 1) * along_u
    one, other = pixel - step, pixel + step
    before = gu * np.take(u, one) + gv * np.take(v, one)
    after = gu * np.take(u, other) + gv * np.take(v, other)
    # One of the two comparisons admits equality, or a plateau of two would lose both.
    peak = np.flatnonzero((centre > before) & (centre >= after))

    pixel, along_u, size = pixel[peak], along_u[peak], np.sqrt(centre[peak])
    profile = np.stack([before[peak] / size, size, after[peak] / size], axis=-1)
    row = pixel // width
    uv_px = np.empty((len(pixel), 2), np.float32)
    uv_px[:, 0], uv_px[:, 1] = pixel - row * width, row + (top - 1)
    offset, _ = peak_of_slope(profile)
    uv_px[:, 0] += offset * along_u
    uv_px[:, 1] += offset * ~along_u
    toward_bright = np.stack([gu[peak], gv[peak]], axis=-1)
    return ThinnedPixels(pixel + (top - 1) * width, toward_bright, along_u, profile, uv_px)


def profile_across(gradient: Gradient, pixels: ThinnedPixels) -> Float[np.ndarray, "n 5"]:
    """(n, 5) another gradient of the same picture across the same edges: along each pixel's own
    direction, at the pixel, the two before and the two after it."""
    normal = pixels.gradient / pixels.profile[:, 1:2]
    step = np.where(pixels.along_u, 1, gradient.u.shape[1])
    u, v = gradient.u.ravel(), gradient.v.ravel()
    near = (pixels.pixel + sign * step for sign in range(-BORDER_PX, BORDER_PX + 1))
    return np.stack([normal[:, 0] * u[at] + normal[:, 1] * v[at] for at in near], axis=-1)
