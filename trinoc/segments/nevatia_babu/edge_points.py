"""Edge points with sub-pixel positions, and straight runs of them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.image.light import Light
from trinoc.image.step_edge import peak_of_slope
from trinoc.segments.nevatia_babu.masks import GradientKernel
from trinoc.segments.nevatia_babu.thinning import ThinnedPixels

# A profile is no peak if a side is below this share of the middle, or if its maximum is this many
# pixels of the level away.
LEAST_SIDE, FARTHEST = 0.02, 1.5  # numerical: guards of a parabola through three logarithms


class PyramidLevel(NamedTuple):
    """One resolution of an image; lengths are in pixels of the full image.

    Attributes
    ----------
    picture : Light
        Levels and light.
    kernel : GradientKernel
        Gradient kernel.
    spacing_px : float
        Distance between two pixels of this level.
    kernel_variance_px2 : float
        Variance of the smoothing by the kernel at this level.
    sigma_strength : float
        Standard deviation of the gradient by noise, grey levels per px.
    slope_variance : float
        Variance by noise of the slope of the profile across a straight edge, averaged over one
        pixel of its length, (grey levels per px^2)^2.
    """

    picture: Light
    kernel: GradientKernel
    spacing_px: float
    kernel_variance_px2: float
    sigma_strength: float
    slope_variance: float

    @property
    def noise_sigma(self) -> float:
        """Standard deviation of the noise of the grey levels."""
        return self.sigma_strength * self.spacing_px / self.kernel.noise_gain


class EdgePoints(NamedTuple):
    """Points on edges, in pixels and grey levels of the full image, from either level.

    Attributes
    ----------
    sample_px : (n, 2)
        Centre of the pixel at which the profile was sampled.
    spacing_px : (n,)
        Pixel distance of the point's level.
    kernel_variance_px2 : (n,)
        Variance of the smoothing by the kernel at that level.
    normal : (n, 2)
        Unit vector across the edge, toward the brighter side.
    along_u : (n,)
        True if the profile was sampled along u, False for v.
    profile : (n, 3)
        Gradient along `normal` at the pixel before, at and after the point, grey levels per px. For
        a nonlinear camera response: gradient of the light, scaled so that the middle value is that
        of the grey levels.
    light_per_level : (n,)
        Ratio of the slope of the light to that of the grey levels.
    uv_px : (n, 2)
        Sub-pixel position.
    strength : (n,)
        Size of the gradient, grey levels per px.
    sharpness : (n,)
        Nominal variance of the profile (blur of one pixel) over the measured one. Noise can make
        the measured variance of a weak point arbitrarily large; its inverse can be averaged.
    information : (n,)
        Information on the position of the edge across it, px^2. The variance of a line by noise is
        (variance of its profile)^2 / sum of information.
    snr2 : (n,)
        Squared ratio of the strength to its standard deviation by noise.
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
        """Points at the given indices, in that order, or where the mask is true."""
        index = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return EdgePoints(*(np.take(field, index, axis=0) for field in self))

    @classmethod
    def of_level(cls, pixels: ThinnedPixels, level: PyramidLevel) -> "EdgePoints":
        """Convert thinned pixels of a level to points of the full image."""
        count, spacing = len(pixels.pixel), np.float32(level.spacing_px)
        size = pixels.profile[:, 1]
        normal = pixels.gradient / size[:, None]
        strength = size / spacing
        along_u = pixels.along_u
        larger = np.abs(np.where(along_u, normal[:, 0], normal[:, 1]))
        # A point of an oblique edge represents more than one pixel of its length.
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
        _, variance = points.locate(points.profile)
        return points._replace(sharpness=(points.kernel_variance_px2 + 1) / variance)

    def place_in_light(self, light: Float[np.ndarray, "n 5"]) -> "EdgePoints":
        """Move the points to the edge in the light, from its gradient at five pixels, (n, 5).

        The new profile is centred on the one of the three middle pixels with the largest gradient.
        A point without a peak of the light nearby keeps the position of the grey levels.
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
        uv_px, variance = moved.locate(moved.profile)
        far = np.abs(uv_px - moved.sample_px).max(axis=1) > FARTHEST * self.spacing_px
        return moved._replace(
            uv_px=np.where(far[:, None], self.uv_px, uv_px),
            sharpness=np.where(far, self.sharpness, (self.kernel_variance_px2 + 1) / variance),
        )

    def locate(
        self, profile: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n"]]:
        """(position, variance across the edge) of the Gaussian through `profile`."""
        offset, variance = peak_of_slope(profile)
        offset = offset * self.spacing_px
        larger = np.where(self.along_u, self.normal[:, 0], self.normal[:, 1])
        uv_px = self.sample_px.copy()
        uv_px[:, 0] += offset * self.along_u
        uv_px[:, 1] += offset * ~self.along_u
        return uv_px, variance * np.square(larger * self.spacing_px)


class Runs(NamedTuple):
    """Straight runs of edge points, in sequence.

    Attributes
    ----------
    points : EdgePoints
        Points of all runs, (n,).
    run : (n,)
        Run of each point.
    first, count : (r,)
        Index of the first point and number of points of each run.
    """

    points: EdgePoints
    run: Int[np.ndarray, "n"]
    first: Int[np.ndarray, "r"]
    count: Int[np.ndarray, "r"]

    @classmethod
    def from_counts(cls, points: EdgePoints, count: Int[np.ndarray, "r"]) -> "Runs":
        """Runs of points that are sorted by run, from the number of points in each."""
        return cls(points, np.repeat(np.arange(len(count)), count), np.cumsum(count) - count, count)

    def take(self, keep: Bool[np.ndarray, "r"]) -> "Runs":
        """The runs where the mask is true."""
        return Runs.from_counts(self.points.take(np.take(keep, self.run)), self.count[keep])

    def total(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Sum over the points of each run."""
        return np.add.reduceat(of_points, self.first).astype(np.float64)

    def mean(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Mean over the points of each run."""
        return self.total(of_points) / self.count

    def spread(self, of_runs: Shaped[np.ndarray, "r *d"]) -> Shaped[np.ndarray, "n *d"]:
        """Value of each run, repeated at all of its points."""
        return np.take(of_runs, self.run, axis=0)

    def differ_from(self, other: "Runs") -> Bool[np.ndarray, "r"]:
        """Mask of the runs with a point of another position or strength than in `other`, (r,)."""
        points, other_points = self.points, other.points
        is_moved = (points.uv_px.T != other_points.uv_px.T).any(axis=0)
        return self.total(is_moved | (points.strength != other_points.strength)) > 0

    def move(self, uv_px: Float[np.ndarray, "n 2"]) -> "Runs":
        """The same points at other positions."""
        return self._replace(points=self.points._replace(uv_px=uv_px))
