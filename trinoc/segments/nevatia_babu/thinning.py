"""Thinning: pixels whose gradient is largest across the edge.

Nevatia and Babu keep a pixel when its magnitude exceeds the magnitudes of its two neighbours
across the edge, and those neighbours point about the same way. Both conditions are one here:
the neighbours' gradients are projected on the pixel's own direction before comparison.

The six 5 x 5 edge masks of Nevatia and Babu, and their combination into one gradient.

Each mask answers best to a step edge of one direction; its sign tells the side that is
brighter, so that six masks tell twelve directions. `correlate_gradient` correlates a picture with
them all at once.
"""

import functools
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import peak_of_slope

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
    whole, u = _smooth_picture(np.pad(masks[0], 2), cv2.CV_64F), np.arange(-4, 5)
    # Integrating the kernel across the edge turns u into u^2 / 2 and u^3 into u^4 / 4: the
    # variance of the implied smoothing is a third of the ratio of its third to first moment.
    variance = (whole * u**3).sum() / (3 * (whole * u).sum())
    # The average along the edge is the answer of the kernel collapsed along it.
    collapsed = np.pad(whole.sum(axis=0), 1)
    slope_gain = (np.square(collapsed[2:] - collapsed[:-2]) / 4).sum()
    noise_gain = np.sqrt((whole**2).sum())
    return GradientKernel(masks, float(variance), float(noise_gain), float(slope_gain))


def _smooth_picture(grey: np.ndarray, depth: int) -> np.ndarray:
    return cv2.sepFilter2D(grey, depth, _BINOMIAL, _BINOMIAL, borderType=_BORDER)


class Gradient(NamedTuple):
    """(h, w) gradient along u and v in grey levels per pixel, and its squared size."""

    u: Float[np.ndarray, "h w"]
    v: Float[np.ndarray, "h w"]
    squared: Float[np.ndarray, "h w"]


def correlate_gradient(grey: Float[np.ndarray, "h w"], kernel: GradientKernel) -> Gradient:
    """Correlate the picture with both kernels; beyond its border the picture continues level."""
    # Smoothing first and the small masks after costs half as much as one large kernel.
    smooth = _smooth_picture(grey, cv2.CV_32F)
    u, v = (
        cv2.filter2D(smooth, cv2.CV_32F, mask.astype(np.float32), borderType=_BORDER)
        for mask in kernel.masks
    )
    # Rounded as NumPy rounds the products of neighbours: on a plateau they are equal.
    squared = u * u
    squared += v * v
    return Gradient(u, v, squared)


# Linking looks two pixels to each side.
BORDER_PX = 2  # numerical: the 24 pixels about one
# Pixels that are worked on at a time; rows that smoothing and masks look beyond their own.
_STRIP_PX, _HALO_PX = 1 << 17, 3  # numerical: size of a block


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


def thin_pixels(
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
        gradient = correlate_gradient(grey[above : bottom + 1 + _HALO_PX], kernel)
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


def sample_profiles(gradient: Gradient, pixels: ThinnedPixels) -> Float[np.ndarray, "n 5"]:
    """(n, 5) another gradient of the same picture across the same edges: along each pixel's own
    direction, at the pixel, the two before and the two after it."""
    normal = pixels.gradient / pixels.profile[:, 1:2]
    step = np.where(pixels.along_u, 1, gradient.u.shape[1])
    u, v = gradient.u.ravel(), gradient.v.ravel()
    near = (pixels.pixel + sign * step for sign in range(-BORDER_PX, BORDER_PX + 1))
    return np.stack([normal[:, 0] * u[at] + normal[:, 1] * v[at] for at in near], axis=-1)
