"""Thinning: pixels whose gradient is a maximum across the edge.

Nevatia and Babu require a magnitude above those of the two neighbours across the edge, and
neighbours of a similar direction. Here both conditions are one: the neighbours' gradients are
projected on the pixel's direction before the comparison.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import peak_of_slope
from trinoc.segments.nevatia_babu.masks import Gradient, GradientKernel, correlate_gradient

# Linking needs two pixels on each side.
BORDER_PX = 2  # numerical: the 24 pixels about one
# Pixels per strip; rows that smoothing and masks need beyond a strip.
_STRIP_PX, _HALO_PX = 1 << 17, 3  # numerical: size of a block


class ThinnedPixels(NamedTuple):
    """Pixels whose gradient is a maximum across an edge; lengths are in pixels of their resolution.

    Attributes
    ----------
    pixel : (n,)
        Index of the pixel in the flattened image.
    gradient : (n, 2)
        Gradient (u, v), toward the brighter side, grey levels per px.
    along_u : (n,)
        True if the gradient is nearer to the u axis, False for the v axis.
    profile : (n, 3)
        Gradients at the pixel before, at the pixel, and at the pixel after it along that axis. All
        three are projected on the direction of the gradient at the pixel.
    uv_px : (n, 2)
        Sub-pixel peak of the profile.
    """

    pixel: Int[np.ndarray, "n"]
    gradient: Float[np.ndarray, "n 2"]
    along_u: Bool[np.ndarray, "n"]
    profile: Float[np.ndarray, "n 3"]
    uv_px: Float[np.ndarray, "n 2"]

    def take(self, which: np.ndarray) -> "ThinnedPixels":
        """Return the pixels with the given indices."""
        return ThinnedPixels(*(np.take(field, which, axis=0) for field in self))

    @property
    def direction(self) -> Float[np.ndarray, "n 2"]:
        """Unit vector along the edge, with the darker side on the right, (n, 2)."""
        return self.gradient[:, ::-1] * np.array([-1, 1], np.float32) / self.profile[:, 1:2]


def thin_pixels(
    grey: Float[np.ndarray, "h w"],
    kernel: GradientKernel,
    least_strength: float,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> ThinnedPixels:
    """Return the pixels whose gradient is at least `least_strength` and a maximum across the edge.

    A pixel is compared with its two neighbours along the image axis nearer to its gradient, so that
    no interpolation is needed. Pixels in the mask `excluded` are skipped.
    """
    height, width = grey.shape
    # Strip by strip, so that the data stay in the processor's cache.
    rows = max(_STRIP_PX // width, 2 * _HALO_PX)
    strips: list[ThinnedPixels] = []
    for top in range(BORDER_PX, height - BORDER_PX, rows):
        bottom = min(top + rows, height - BORDER_PX)
        above = max(top - 1 - _HALO_PX, 0)
        gradient = correlate_gradient(grey[above : bottom + 1 + _HALO_PX], kernel)
        inner_rows = slice(top - 1 - above, bottom + 1 - above)
        free = None if excluded is None else ~excluded[top:bottom]
        strips.append(
            _peaks(Gradient(*(part[inner_rows] for part in gradient)), top, least_strength, free)
        )
    return ThinnedPixels(*(np.concatenate(field) for field in zip(*strips, strict=True)))


def _peaks(
    gradient: Gradient,
    top: int,
    least_strength: float,
    free: Bool[np.ndarray, "_h w"] | None,
) -> ThinnedPixels:
    """Return the thinned pixels of a strip of the image that begins at row `top`.

    `gradient` has one more row above and below the strip. `free` is the mask of pixels to use.
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
    # One of the two comparisons allows equality, or a plateau of two would lose both pixels.
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


def sample_profiles(gradient: Gradient, pixels: ThinnedPixels) -> Float[np.ndarray, "n 5"]:
    """Sample the gradient of another image at five pixels across each edge, (n, 5).

    The samples are at the pixel, two before and two after it. Gradients are projected on the
    direction of the pixel's gradient.
    """
    normal = pixels.gradient / pixels.profile[:, 1:2]
    step = np.where(pixels.along_u, 1, gradient.u.shape[1])
    u, v = gradient.u.ravel(), gradient.v.ravel()
    samples = (pixels.pixel + sign * step for sign in range(-BORDER_PX, BORDER_PX + 1))
    return np.stack(
        [normal[:, 0] * u[sample] + normal[:, 1] * v[sample] for sample in samples], axis=-1
    )
