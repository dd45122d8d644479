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
    """The image at one resolution (full or half); lengths are in pixels of the full image.

    Attributes
    ----------
    picture : Light
        Grey levels and light at this resolution.
    kernel : GradientKernel
        Gradient kernel.
    spacing_px : float
        Distance between two pixels of this level.
    kernel_variance_px2 : float
        Variance of the smoothing by the kernel at this level.
    sigma_strength : float
        Standard deviation of the gradient due to noise, grey levels per px.
    slope_variance : float
        Variance due to noise of the slope of the gradient profile across a straight edge, (grey
        levels per px^2)^2. The profile is averaged over one pixel of the edge's length.
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
    """Edge points of both resolutions, in pixels and grey levels of the full image.

    The profile of a point consists of three gradients, sampled along the image axis nearer to the
    normal of the edge.

    Attributes
    ----------
    sample_px : (n, 2)
        Centre of the middle pixel of the profile.
    spacing_px : (n,)
        Distance between two pixels of the point's resolution.
    kernel_variance_px2 : (n,)
        Variance of the smoothing by the kernel at that resolution.
    normal : (n, 2)
        Unit vector across the edge, toward the brighter side.
    along_u : (n,)
        True if the profile was sampled along u, False for v.
    profile : (n, 3)
        Gradient along `normal` at the pixel before, at and after the point, grey levels per px.
        With a nonlinear camera response, these are gradients of the light, scaled so that the
        middle value is the gradient of the grey levels.
    light_per_level : (n,)
        Gradient of the light over gradient of the grey levels.
    uv_px : (n, 2)
        Sub-pixel position.
    strength : (n,)
        Magnitude of the gradient, grey levels per px.
    sharpness : (n,)
        Nominal variance of the profile (for a blur of one pixel) over its measured variance. Unlike
        the measured variance, which noise can make arbitrarily large, this ratio can be averaged.
    information : (n,)
        Weight of the point for the position of a line. The variance of a line due to noise is
        (variance of its profile)^2 / sum of the weights.
    snr2 : (n,)
        Squared ratio of the strength to its standard deviation due to noise.
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
        """Return the points with the given indices, or the points for which a mask is true."""
        index = np.flatnonzero(which) if which.dtype == np.bool_ else which
        return EdgePoints(*(np.take(field, index, axis=0) for field in self))

    @classmethod
    def of_level(cls, pixels: ThinnedPixels, level: PyramidLevel) -> "EdgePoints":
        """Build edge points from the thinned pixels of one resolution."""
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
        """Return the points at the positions of the edges in the light, instead of in the grey
        levels.

        `light` is the gradient of the light at five pixels across each edge. The new profile is
        centred on the pixel with the largest gradient among the three middle pixels. A point
        without a peak of the light nearby keeps its position.
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
        """Fit a Gaussian through the three values of each `profile`.

        Returns the position of the Gaussian (n, 2), px, and its variance across the edge (n,),
        px^2.
        """
        offset, variance = peak_of_slope(profile)
        offset = offset * self.spacing_px
        larger = np.where(self.along_u, self.normal[:, 0], self.normal[:, 1])
        uv_px = self.sample_px.copy()
        uv_px[:, 0] += offset * self.along_u
        uv_px[:, 1] += offset * ~self.along_u
        return uv_px, variance * np.square(larger * self.spacing_px)


class Runs(NamedTuple):
    """Straight runs of edge points. The points are sorted by run, and along each run.

    Attributes
    ----------
    points : EdgePoints
        The n points of all runs.
    run : (n,)
        Run of each point.
    first, count : (r,)
        Index of the first point, and number of points, of each run.
    """

    points: EdgePoints
    run: Int[np.ndarray, "n"]
    first: Int[np.ndarray, "r"]
    count: Int[np.ndarray, "r"]

    @classmethod
    def from_counts(cls, points: EdgePoints, count: Int[np.ndarray, "r"]) -> "Runs":
        """Build runs from points that are sorted by run, and the number of points in each run."""
        return cls(points, np.repeat(np.arange(len(count)), count), np.cumsum(count) - count, count)

    def take(self, keep: Bool[np.ndarray, "r"]) -> "Runs":
        """Return the runs for which the mask is true."""
        return Runs.from_counts(self.points.take(np.take(keep, self.run)), self.count[keep])

    def total(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Return the sum of the points' values over each run, (r,)."""
        return np.add.reduceat(of_points, self.first).astype(np.float64)

    def mean(self, of_points: Float[np.ndarray, "n"]) -> Float[np.ndarray, "r"]:
        """Return the mean of the points' values over each run, (r,)."""
        return self.total(of_points) / self.count

    def spread(self, of_runs: Shaped[np.ndarray, "r *d"]) -> Shaped[np.ndarray, "n *d"]:
        """Return for each point the value of its run, (n, ...)."""
        return np.take(of_runs, self.run, axis=0)

    def differ_from(self, other: "Runs") -> Bool[np.ndarray, "r"]:
        """Return the mask of the runs with a point whose position or strength differs from `other`,
        (r,).
        """
        points, other_points = self.points, other.points
        is_moved = (points.uv_px.T != other_points.uv_px.T).any(axis=0)
        return self.total(is_moved | (points.strength != other_points.strength)) > 0

    def move(self, uv_px: Float[np.ndarray, "n 2"]) -> "Runs":
        """Return the runs with the points at other positions."""
        return self._replace(points=self.points._replace(uv_px=uv_px))
