"""Edge points, their location to sub-pixels, and straight runs of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.image import Light, peak_of_slope
from trinoc.numerics import members
from trinoc.segments.nevatia_babu.masks import GradientKernel
from trinoc.segments.nevatia_babu.thinning import ThinnedPixels

# A profile is no peak where a side has less than this share of the middle, or where its top is
# this many pixels of the level away.
LEAST_SIDE, FARTHEST = 0.02, 1.5


class Level(NamedTuple):
    """One resolution of a picture; lengths are in pixels of the full picture.

    Fields
    ------
    picture : levels and light. kernel : of the gradient.
    spacing_px : distance between two pixels of this level.
    kernel_variance_px2 : variance of the smoothing by the kernel at this level.
    sigma_strength : standard deviation of the gradient from noise, in grey levels per pixel.
    slope_variance : variance that noise gives the slope of the profile across a straight
        edge, averaged over one pixel of its length, in (grey levels per squared pixel)^2.
    """

    picture: Light
    kernel: GradientKernel
    spacing_px: float
    kernel_variance_px2: float
    sigma_strength: float
    slope_variance: float

    @property
    def noise_sigma(self) -> float:
        """Standard deviation of the noise of its grey levels."""
        return self.sigma_strength * self.spacing_px / self.kernel.noise_gain


class EdgePoints(NamedTuple):
    """Points of edges, in pixels and grey levels of the full picture whatever their level.

    Fields
    ------
    sample_px : (n, 2) centre of the pixel at which the profile was taken.
    spacing_px : (n,) distance of two pixels of the point's level.
    kernel_variance_px2 : (n,) variance of the smoothing by the kernel at that level.
    normal : (n, 2) unit vector across the edge, toward the brighter side.
    along_u : (n,) whether the profile was sampled along u, or else along v.
    profile : (n, 3) gradient along `normal` at the pixel before, at and after the point, along
        that axis of the picture, in grey levels per pixel. Where the camera's response is not
        linear: that of the light, scaled so that the middle one is still the grey levels'.
    light_per_level : (n,) slope of the light over the slope of the grey levels at the point.
    uv_px : (n, 2) position to sub-pixels.
    strength : (n,) size of the gradient, in grey levels per pixel.
    sharpness : (n,) nominal variance of the profile, for a blur of one pixel, over the measured
        one. Noise makes the measured variance of a weak point arbitrarily large; its inverse
        can be averaged.
    information : (n,) what the point tells about the place of its edge across it, in px^2:
        the noise leaves a line a variance of (variance of its profile)^2 / sum of information.
    snr2 : (n,) (strength / its standard deviation from noise alone)^2.
    """

    sample_px: Float[np.ndarray, "n 2"]
    spacing_px: Float[np.ndarray, "n"]
    kernel_variance_px2: Float[np.ndarray, "n"]
    normal: Float[np.ndarray, "n 2"]
    along_u: Bool[np.ndarray, "n"]
    profile: Float[np.ndarray, "n 3"]
    light_per_level: Float[np.ndarray, "n"]
    uv_px: Float[np.ndarray, "n 2"]
    strength: Float[np.ndarray, "n"]
    sharpness: Float[np.ndarray, "n"]
    information: Float[np.ndarray, "n"]
    snr2: Float[np.ndarray, "n"]

    def take(self, which: np.ndarray) -> "EdgePoints":
        """The points at the given indices, in that order, or where the mask is true."""
        index = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return EdgePoints(*(np.take(field, index, axis=0) for field in self))

    @classmethod
    def of_level(cls, pixels: ThinnedPixels, level: Level) -> "EdgePoints":
        """Thinned pixels of a level as points of the full picture."""
        count, spacing = len(pixels.pixel), np.float32(level.spacing_px)
        size = pixels.profile[:, 1]
        normal = pixels.gradient / size[:, None]
        strength = size / spacing
        along_u = pixels.along_u
        larger = np.abs(np.where(along_u, normal[:, 0], normal[:, 1]))
        # A point of a slanted edge stands for more than one pixel of its length.
        information = strength**2 * (spacing / larger / np.float32(level.slope_variance))
        to_full = (spacing - 1) / 2
        row, column = np.divmod(pixels.pixel, level.picture.size_px[0])
        sample_px = np.empty((count, 2), np.float32)
        sample_px[:, 0], sample_px[:, 1] = column, row
        points = cls(
            sample_px * spacing + to_full,
            np.full(count, spacing),
            np.full(count, np.float32(level.kernel_variance_px2)),
            normal,
            along_u,
            pixels.profile / spacing,
            np.ones(count, np.float32),
            pixels.uv_px * spacing + to_full,
            strength,
            strength,
            information,
            np.square(strength / np.float32(level.sigma_strength)),
        )
        _, variance = points.located(points.profile)
        return points._replace(sharpness=(points.kernel_variance_px2 + 1) / variance)

    def placed_in_light(self, light: Float[np.ndarray, "n 5"]) -> "EdgePoints":
        """The points where the light has its edge: its gradient, two pixels to both sides.

        The profile is taken about the pixel, of three, at which that gradient is largest. A
        point at which the light has no peak within reach stays where the grey levels have theirs.
        """
        climb = light[:, 1:4].argmax(axis=1)
        profile = np.take_along_axis(light, climb[:, None] + np.arange(3), axis=1)
        middle = profile[:, 1]
        usable = (middle > 0) & (profile > LEAST_SIDE * middle[:, None]).all(axis=1)
        ratio = np.where(usable, middle / self.strength, 1.0).astype(np.float32)
        step = ((climb - 1) * usable * self.spacing_px).astype(np.float32)
        axis = np.stack([self.along_u, ~self.along_u], axis=-1)
        moved = self._replace(
            sample_px=self.sample_px + step[:, None] * axis,
            profile=np.where(usable[:, None], profile / ratio[:, None], self.profile),
            light_per_level=ratio,
        )
        uv_px, variance = moved.located(moved.profile)
        far = np.abs(uv_px - moved.sample_px).max(axis=1) > FARTHEST * self.spacing_px
        return moved._replace(
            uv_px=np.where(far[:, None], self.uv_px, uv_px),
            sharpness=np.where(far, self.sharpness, (self.kernel_variance_px2 + 1) / variance),
        )

    def located(
        self, profile: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
        """(position, variance): peak and width across the edge of a Gaussian through `profile`."""
        offset, variance = peak_of_slope(profile)
        offset = offset * self.spacing_px
        larger = np.where(self.along_u, self.normal[:, 0], self.normal[:, 1])
        uv_px = self.sample_px.copy()
        uv_px[:, 0] += offset * self.along_u
        uv_px[:, 1] += offset * ~self.along_u
        return uv_px, variance * np.square(larger * self.spacing_px)


class Runs(NamedTuple):
    """Straight runs of edge points: `points`, run after run, and (r,) where each begins."""

    points: EdgePoints
    first: Int[np.ndarray, "r"]

    @property
    def count(self) -> Int[np.ndarray, "r"]:
        """(r,) number of points of each run."""
        return np.diff(np.append(self.first, len(self.points.strength)))

    def take(self, keep: Bool[np.ndarray, "r"]) -> "Runs":
        """The runs where the mask is true."""
        index, _, first = members(self.first[keep], (self.first + self.count)[keep])
        return Runs(self.points.take(index), first)

    def total(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Sum over the points of each run."""
        return np.add.reduceat(of_points, self.first).astype(np.float64)

    def mean(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Mean over the points of each run."""
        return self.total(of_points) / self.count

    def spread(self, of_runs: Shaped[np.ndarray, "r *d"]) -> Shaped[np.ndarray, "n *d"]:
        """Each run's value at all of its points."""
        return np.repeat(of_runs, self.count, axis=0)

    def moved(self, uv_px: Float[np.ndarray, "n 2"]) -> "Runs":
        """The same points elsewhere."""
        return self._replace(points=self.points._replace(uv_px=uv_px))
