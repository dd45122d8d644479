"""From grey levels to straight runs of edge points, at full and at half resolution.

The fine level places edges well and parts neighbours; the coarse one averages four pixels
into one and so sees edges of half the contrast. It serves where the fine level sees nothing.

Edge points, their location to sub-pixels, and straight runs of them.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.image.light import Light
from trinoc.image.noise import level_noise
from trinoc.image.step_edge import peak_of_slope
from trinoc.numerics.joins import expand_ranges
from trinoc.segments.nevatia_babu.chains import order_chains, split_chains, successors
from trinoc.segments.nevatia_babu.thinning import (
    GradientKernel,
    ThinnedPixels,
    correlate_gradient,
    sample_profiles,
    thin_pixels,
)
from trinoc.segments.tuning import DEFAULT, ScaleTuning

# A profile is no peak where a side has less than this share of the middle, or where its top is
# this many pixels of the level away.
LEAST_SIDE, FARTHEST = 0.02, 1.5  # numerical: guards of a parabola through three logarithms


class PyramidLevel(NamedTuple):
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
    def of_level(cls, pixels: ThinnedPixels, level: PyramidLevel) -> "EdgePoints":
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
        _, variance = points.locate(points.profile)
        return points._replace(sharpness=(points.kernel_variance_px2 + 1) / variance)

    def place_in_light(self, light: Float[np.ndarray, "n 5"]) -> "EdgePoints":
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
        uv_px, variance = moved.locate(moved.profile)
        far = np.abs(uv_px - moved.sample_px).max(axis=1) > FARTHEST * self.spacing_px
        return moved._replace(
            uv_px=np.where(far[:, None], self.uv_px, uv_px),
            sharpness=np.where(far, self.sharpness, (self.kernel_variance_px2 + 1) / variance),
        )

    def locate(
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
    """Straight runs of edge points, one after the other.

    Fields
    ------
    points : (n,) of all runs. run : (n,) the run of each.
    first, count : (r,) where each run begins, and its number of points.
    """

    points: EdgePoints
    run: Int[np.ndarray, "n"]
    first: Int[np.ndarray, "r"]
    count: Int[np.ndarray, "r"]

    @classmethod
    def from_counts(cls, points: EdgePoints, count: Int[np.ndarray, "r"]) -> "Runs":
        """Points in the order of their runs, of so many points each."""
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
        """Each run's value at all of its points."""
        return np.take(of_runs, self.run, axis=0)

    def differ_from(self, other: "Runs") -> Bool[np.ndarray, "r"]:
        """Of the same runs, those whose points lie elsewhere or count for more or less there."""
        own, others = self.points, other.points
        moved = (own.uv_px.T != others.uv_px.T).any(axis=0)
        return self.total(moved | (own.strength != others.strength)) > 0

    def move(self, uv_px: Float[np.ndarray, "n 2"]) -> "Runs":
        """The same points elsewhere."""
        return self._replace(points=self.points._replace(uv_px=uv_px))


# Rows enough for a noise good to one part in a hundred; more would only cost time.
_MOST_ROWS = 60  # numerical: size of a sample
# The end points of a run lie where the chain bends: the corner pulls them.
_TRIMMED_POINTS = 1  # numerical: an index


def full_level(picture: Light, kernel: GradientKernel) -> PyramidLevel:
    """The picture itself."""
    return _level(picture, 1.0, kernel)


def half_level(fine: PyramidLevel) -> PyramidLevel:
    """The picture with each two by two pixels averaged; an odd last row or column is left out."""
    picture = fine.picture
    levels = _halve_picture(picture.levels)
    light = levels if picture.is_linear else _halve_picture(picture.light)
    half = picture._replace(levels=levels, light=light, quantum=picture.quantum / 2)
    return _level(half, 2.0, fine.kernel)


def _halve_picture(grey: Float[np.ndarray, "h w"]) -> np.ndarray:
    height, width = (side // 2 * 2 for side in grey.shape)
    return cv2.resize(
        grey[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )


def _level(picture: Light, spacing: float, kernel: GradientKernel) -> PyramidLevel:
    rows = max(1, (len(picture.levels) - 2) // _MOST_ROWS)
    sigma = level_noise(picture.levels, picture.quantum, (rows, 1))
    # Averaging pixels smooths by (spacing^2 - 1) / 12, as does any box.
    variance = kernel.variance_px2 * spacing**2 + (spacing**2 - 1) / 12
    return PyramidLevel(
        picture,
        kernel,
        spacing,
        variance,
        sigma * kernel.noise_gain / spacing,
        sigma**2 * kernel.slope_gain / spacing**3,
    )


def find_runs(
    fine: PyramidLevel,
    tolerance_px: float,
    least_contrast: float,
    tuning: ScaleTuning = DEFAULT.scales,
) -> Runs:
    """Straight runs of both levels, each level where it is the better one.

    Runs that stand out clearly at full resolution are taken from there. Elsewhere the half
    resolution is searched; faint runs of the full one remain where it finds nothing. In
    pictures of so little noise that all runs stand out, the half resolution is left out.
    """
    least_fine = _least_strength(fine, least_contrast, tuning)
    runs = _runs_of_level(fine, least_fine, tolerance_px, tuning.least_fine)
    if least_fine > tuning.clear_ratio * fine.sigma_strength:
        # So little noise that every point stands out clearly.
        return runs
    half = half_level(fine)
    least_half = _least_strength(half, least_contrast, tuning)
    clear = runs.total(runs.points.snr2) > tuning.clear_ratio**2 * runs.count
    pixel, shape = _half_pixel(runs.points, half), half.picture.levels.shape
    shown = _neighbourhood(pixel[runs.spread(clear)], shape)
    coarse = _runs_of_level(half, least_half, tolerance_px, tuning.least_coarse, shown)
    seen_again = _neighbourhood(_half_pixel(coarse.points, half), shape).ravel()[pixel]
    runs = runs.take(clear | (runs.total(seen_again.astype(np.float64)) < 0.5 * runs.count))
    points = (np.concatenate(both) for both in zip(runs.points, coarse.points, strict=True))
    return Runs.from_counts(EdgePoints(*points), np.concatenate([runs.count, coarse.count]))


def _least_strength(level: PyramidLevel, least_contrast: float, tuning: ScaleTuning) -> float:
    """Strength below which a point is noise, or belongs to a step of too little contrast."""
    faint = least_contrast / np.sqrt(2 * np.pi * (level.kernel_variance_px2 + 1.0))
    return max(tuning.threshold * level.sigma_strength, tuning.faint_share * float(faint))


def _runs_of_level(
    level: PyramidLevel,
    least_strength: float,
    tolerance_px: float,
    least_points: int,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> Runs:
    """Masks, thinning, linking and polygons of one level.

    `least_strength` is that of a point, in grey levels per pixel of the full picture,
    `tolerance_px` the largest deviation of a run from its chord. Runs of fewer than
    `least_points` points are left out, and pixels that are `excluded`.
    """
    levels, light = level.picture.levels, level.picture.light
    pixels = thin_pixels(levels, level.kernel, least_strength * level.spacing_px, excluded)
    order, starts = order_chains(successors(pixels, levels.shape), least_points)
    start, stop = split_chains(pixels.uv_px[order], starts, tolerance_px, least_points)
    start, stop = start + _TRIMMED_POINTS, stop - _TRIMMED_POINTS
    _, index = expand_ranges(start, stop)
    points = EdgePoints.of_level(pixels := pixels.take(order[index]), level)
    if not level.picture.is_linear:
        in_light = sample_profiles(correlate_gradient(light, level.kernel), pixels)
        points = points.place_in_light(in_light / np.float32(level.spacing_px))
    return Runs.from_counts(points, stop - start)


def _half_pixel(points: EdgePoints, half: PyramidLevel) -> Int[np.ndarray, "n"]:
    """Index, in the half picture, of the pixel that holds each point."""
    width, height = half.picture.size_px
    column, row = (points.sample_px // 2).astype(np.int64).T
    return np.minimum(row, height - 1) * width + np.minimum(column, width - 1)


def _neighbourhood(pixel: Int[np.ndarray, "n"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """The given pixels and the eight around each."""
    mark = np.zeros(shape, dtype=np.uint8)
    mark.ravel()[pixel] = 1
    return cv2.dilate(mark, np.ones((3, 3), np.uint8)).view(bool)
