"""Edge points and their location to sub-pixels."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.nevatia_babu.levels import Level

_SMALLEST = 1e-6


class EdgePoints(NamedTuple):
    """Points of edges, in pixels and grey levels of the full picture whatever their level.

    Fields
    ------
    pixel : (n,) index of the pixel in the flattened picture of the point's level.
    sample_px : (n, 2) centre of that pixel.
    spacing_px : (n,) distance of two pixels of that level.
    kernel_variance_px2 : (n,) variance of the smoothing by the kernel at that level.
    normal : (n, 2) unit vector across the edge, toward the brighter side.
    along_u : (n,) whether the profile was sampled along u, or else along v.
    profile : (n, 3) gradient along `normal` at the pixel before, at and after the point, along
        that axis of the picture, in grey levels per pixel.
    uv_px : (n, 2) position to sub-pixels.
    strength : (n,) size of the gradient, in grey levels per pixel.
    sharpness : (n,) nominal variance of the profile, for a blur of one pixel, over the measured
        one. Noise makes the measured variance of a weak point arbitrarily large; its inverse
        can be averaged.
    information : (n,) what the point tells about the place of its edge across it, in px^2:
        the noise leaves a line a variance of (variance of its profile)^2 / sum of information.
    evidence : (n,) (strength / its standard deviation from noise alone)^2.
    """

    pixel: Int[np.ndarray, "n"]
    sample_px: Float[np.ndarray, "n 2"]
    spacing_px: Float[np.ndarray, "n"]
    kernel_variance_px2: Float[np.ndarray, "n"]
    normal: Float[np.ndarray, "n 2"]
    along_u: Bool[np.ndarray, "n"]
    profile: Float[np.ndarray, "n 3"]
    uv_px: Float[np.ndarray, "n 2"]
    strength: Float[np.ndarray, "n"]
    sharpness: Float[np.ndarray, "n"]
    information: Float[np.ndarray, "n"]
    evidence: Float[np.ndarray, "n"]

    def select(self, which: np.ndarray) -> "EdgePoints":
        """The points at the given indices, in that order, or where the mask is true."""
        return EdgePoints(*(field[which] for field in self))

    @property
    def direction(self) -> Float[np.ndarray, "n 2"]:
        """(n, 2) along the edge, with the darker side on the right as seen on the picture."""
        return np.stack([-self.normal[:, 1], self.normal[:, 0]], axis=-1)

    @classmethod
    def at_pixels(
        cls,
        pixel: Int[np.ndarray, "n"],
        gradient: Float[np.ndarray, "n 2"],
        along_u: Bool[np.ndarray, "n"],
        profile: Float[np.ndarray, "n 3"],
        level: Level,
    ) -> "EdgePoints":
        """Points at pixels of a level, with gradients and profiles per pixel of that level."""
        count, spacing = len(pixel), np.float32(level.spacing_px)
        row, column = np.divmod(pixel, level.grey.shape[1])
        sample_px = np.stack([column, row], axis=-1).astype(np.float32) * spacing
        sample_px += (spacing - 1) / 2
        size = np.sqrt((gradient * gradient).sum(axis=-1))
        normal = gradient / size[:, None]
        strength = size / spacing
        larger = np.abs(np.where(along_u, normal[:, 0], normal[:, 1]))
        # A point of a slanted edge stands for more than one pixel of its length.
        information = strength**2 * (spacing / larger / np.float32(level.slope_variance))
        points = cls(
            pixel,
            sample_px,
            np.full(count, spacing),
            np.full(count, np.float32(level.kernel_variance_px2)),
            normal,
            along_u,
            profile / spacing,
            sample_px,
            strength,
            strength,
            information,
            np.square(strength / np.float32(level.sigma_strength)),
        )
        uv_px, variance = points.located(points.profile)
        return points._replace(uv_px=uv_px, sharpness=(points.kernel_variance_px2 + 1) / variance)

    def located(
        self, profile: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
        """(position, variance): peak and width across the edge of a Gaussian through `profile`.

        A Gaussian cut at a slant is again Gaussian: the parabola through the logarithms of
        the three samples gives both exactly where blur and kernel are Gaussian.
        """
        offset, variance = peak_of_profile(profile)
        offset = offset * self.spacing_px
        larger = np.where(self.along_u, self.normal[:, 0], self.normal[:, 1])
        uv_px = self.sample_px.copy()
        uv_px[:, 0] += offset * self.along_u
        uv_px[:, 1] += offset * ~self.along_u
        return uv_px, variance * np.square(larger * self.spacing_px)


def joined(one: EdgePoints, other: EdgePoints) -> EdgePoints:
    """The points of both, one after the other."""
    return EdgePoints(*(np.concatenate(pair) for pair in zip(one, other, strict=True)))


def peak_of_profile(
    profile: Float[np.ndarray, "n 3"],
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """(offset, variance) of the Gaussian through three samples, one apart.

    The offset counts from the middle sample.
    """
    level = np.log(np.maximum(profile, _SMALLEST))
    low, high = level[:, 0] - level[:, 1], level[:, 2] - level[:, 1]
    curvature = np.minimum(low + high, -_SMALLEST)
    return 0.5 * (low - high) / curvature, -1 / curvature
