"""Straight runs of edge points, from full and from half resolution.

The fine level locates edges precisely and separates neighbours. The coarse level averages four
pixels into one and so detects edges of half the contrast. It is used where the fine level detects
nothing.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.light import Light
from trinoc.image.noise import level_noise
from trinoc.numerics.joins import expand_ranges
from trinoc.segments.nevatia_babu.chains import order_chains, split_chains, successors
from trinoc.segments.nevatia_babu.edge_points import EdgePoints, PyramidLevel, Runs
from trinoc.segments.nevatia_babu.masks import GradientKernel, correlate_gradient
from trinoc.segments.nevatia_babu.thinning import sample_profiles, thin_pixels
from trinoc.segments.tuning import DEFAULT, ScaleTuning

# Number of rows for an estimate of the noise to 1 %.
_MOST_ROWS = 60  # numerical: size of a sample
# Points dropped at either end of a run: the chain bends there, and the corner shifts them.
_TRIMMED_POINTS = 1  # numerical: an index


def full_level(picture: Light, kernel: GradientKernel) -> PyramidLevel:
    """Return the image at full resolution, with its noise."""
    return _level(picture, 1.0, kernel)


def half_level(fine: PyramidLevel) -> PyramidLevel:
    """Return the image at half resolution: means of two by two pixels.

    An odd last row or column is dropped.
    """
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
    # Averaging pixels adds the variance of a box, (spacing^2 - 1) / 12.
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
    """Detect straight runs of edge points at full and at half resolution.

    Runs with little noise at full resolution are kept. Elsewhere, the half resolution is searched.
    Noisy runs of the full resolution remain if no run of the half resolution replaces them. If no
    run is noisy, the half resolution is not searched.
    """
    least_fine = _least_strength(fine, least_contrast, tuning)
    runs = _runs_of_level(fine, least_fine, tolerance_px, tuning.least_fine)
    if least_fine > tuning.clear_ratio * fine.sigma_strength:
        # Noise is so low that every point is clear.
        return runs
    half = half_level(fine)
    least_half = _least_strength(half, least_contrast, tuning)
    clear = runs.total(runs.points.snr2) > tuning.clear_ratio**2 * runs.count
    pixel, shape = _half_pixel(runs.points, half), half.picture.levels.shape
    excluded = _neighbourhood(pixel[runs.spread(clear)], shape)
    coarse = _runs_of_level(half, least_half, tolerance_px, tuning.least_coarse, excluded)
    is_repeated = _neighbourhood(_half_pixel(coarse.points, half), shape).ravel()[pixel]
    runs = runs.take(clear | (runs.total(is_repeated.astype(np.float64)) < 0.5 * runs.count))
    points = (np.concatenate(both) for both in zip(runs.points, coarse.points, strict=True))
    return Runs.from_counts(EdgePoints(*points), np.concatenate([runs.count, coarse.count]))


def _least_strength(level: PyramidLevel, least_contrast: float, tuning: ScaleTuning) -> float:
    """Return the smallest gradient of an edge point, grey levels per px.

    The value exceeds noise, and is at least a share of the gradient of a step with the smallest
    contrast.
    """
    faint = least_contrast / np.sqrt(2 * np.pi * (level.kernel_variance_px2 + 1.0))
    return max(tuning.threshold * level.sigma_strength, tuning.faint_share * float(faint))


def _runs_of_level(
    level: PyramidLevel,
    least_strength: float,
    tolerance_px: float,
    least_points: int,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> Runs:
    """Detect straight runs of edge points at one resolution.

    Parameters
    ----------
    level : PyramidLevel
        Image at this resolution.
    least_strength : float
        Smallest gradient of a point, grey levels per px of the full image.
    tolerance_px : float
        Largest deviation of a run from its chord.
    least_points : int
        Smallest number of points of a run.
    excluded : (h, w), optional
        Mask of pixels to skip.
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
    """Return the pixel of the half-resolution image at each point, as an index of the flattened
    image.
    """
    width, height = half.picture.size_px
    column, row = (points.sample_px // 2).astype(np.int64).T
    return np.minimum(row, height - 1) * width + np.minimum(column, width - 1)


def _neighbourhood(pixel: Int[np.ndarray, "n"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """Return the mask of the given pixels and their eight neighbours, (h, w)."""
    mark = np.zeros(shape, dtype=np.uint8)
    mark.ravel()[pixel] = 1
    return cv2.dilate(mark, np.ones((3, 3), np.uint8)).view(bool)
