"""From grey levels to straight runs of edge points, at full and at half resolution.

The fine level places edges well and parts neighbours; the coarse one averages four pixels
into one and so sees edges of half the contrast. It serves where the fine level sees nothing.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image import Light, level_noise
from trinoc.numerics import members
from trinoc.segments.nevatia_babu.chains import ordered_chains, split_chains, successors
from trinoc.segments.nevatia_babu.edge_points import EdgePoints, Level, Runs
from trinoc.segments.nevatia_babu.masks import GradientKernel, gradient_of
from trinoc.segments.nevatia_babu.thinning import profile_across, thinned_pixels
from trinoc.segments.tuning import DEFAULT, ScaleTuning

# Rows enough for a noise good to one part in a hundred; more would only cost time.
_MOST_ROWS = 60
# The end points of a run lie where the chain bends: the corner pulls them.
_TRIMMED_POINTS = 1


def full_level(picture: Light, kernel: GradientKernel) -> Level:
    """The picture itself."""
    return _level(picture, 1.0, kernel)


def half_level(fine: Level) -> Level:
    """The picture with each two by two pixels averaged; an odd last row or column is left out."""
    picture = fine.picture
    levels = _halved(picture.levels)
    light = levels if picture.is_linear else _halved(picture.light)
    half = picture._replace(levels=levels, light=light, quantum=picture.quantum / 2)
    return _level(half, 2.0, fine.kernel)


def _halved(grey: Float[np.ndarray, "h w"]) -> np.ndarray:
    height, width = (side // 2 * 2 for side in grey.shape)
    return cv2.resize(
        grey[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )


def _level(picture: Light, spacing: float, kernel: GradientKernel) -> Level:
    rows = max(1, (len(picture.levels) - 2) // _MOST_ROWS)
    sigma = level_noise(picture.levels, picture.quantum, (rows, 1))
    # Averaging pixels smooths by (spacing^2 - 1) / 12, as does any box.
    variance = kernel.variance_px2 * spacing**2 + (spacing**2 - 1) / 12
    return Level(
        picture,
        kernel,
        spacing,
        variance,
        sigma * kernel.noise_gain / spacing,
        sigma**2 * kernel.slope_gain / spacing**3,
    )


def find_runs(
    fine: Level,
    tolerance_px: float,
    least_contrast: float,
    tuning: ScaleTuning = DEFAULT.scales,
) -> Runs:
    """Straight runs of both levels, each level where it is the better one.

    Runs that stand out clearly at full resolution are taken from there. Elsewhere the half
    resolution is searched; faint runs of the full one remain where it finds nothing. In
    pictures of so little noise that all runs stand out, the half resolution is left out.
    """
    least_fine = _least_strength(fine, tuning.fine_threshold, least_contrast, tuning)
    runs = _runs_of_level(fine, least_fine, tolerance_px, tuning.least_fine)
    if least_fine > tuning.clear_ratio * fine.sigma_strength:
        # So little noise that every point stands out clearly.
        return runs
    half = half_level(fine)
    least_half = _least_strength(half, tuning.coarse_threshold, least_contrast, tuning)
    clear = runs.total(runs.points.snr2) > tuning.clear_ratio**2 * runs.count
    pixel, shape = _half_pixel(runs.points, half), half.picture.levels.shape
    shown = _neighbourhood(pixel[runs.spread(clear)], shape)
    coarse = _runs_of_level(half, least_half, tolerance_px, tuning.least_coarse, shown)
    seen_again = _neighbourhood(_half_pixel(coarse.points, half), shape).ravel()[pixel]
    runs = runs.take(clear | (runs.total(seen_again.astype(np.float64)) < 0.5 * runs.count))
    points = (np.concatenate(both) for both in zip(runs.points, coarse.points, strict=True))
    behind = coarse.first + len(runs.points.strength)
    return Runs(EdgePoints(*points), np.concatenate([runs.first, behind]))


def _least_strength(
    level: Level, threshold: float, least_contrast: float, tuning: ScaleTuning
) -> float:
    """Strength below which a point is noise, or belongs to a step of too little contrast."""
    faint = least_contrast / np.sqrt(2 * np.pi * (level.kernel_variance_px2 + 1.0))
    return max(threshold * level.sigma_strength, tuning.faint_share * float(faint))


def _runs_of_level(
    level: Level,
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
    pixels = thinned_pixels(levels, level.kernel, least_strength * level.spacing_px, excluded)
    order, starts = ordered_chains(successors(pixels, levels.shape), least_points)
    start, stop = split_chains(pixels.uv_px[order], starts, tolerance_px, least_points)
    index, _, first = members(start + _TRIMMED_POINTS, stop - _TRIMMED_POINTS)
    points = EdgePoints.of_level(pixels := pixels.take(order[index]), level)
    if not level.picture.is_linear:
        in_light = profile_across(gradient_of(light, level.kernel), pixels)
        points = points.placed_in_light(in_light / np.float32(level.spacing_px))
    return Runs(points, first)


def _half_pixel(points: EdgePoints, half: Level) -> Int[np.ndarray, "n"]:
    """Index, in the half picture, of the pixel that holds each point."""
    width, height = half.picture.size_px
    column, row = (points.sample_px // 2).astype(np.int64).T
    return np.minimum(row, height - 1) * width + np.minimum(column, width - 1)


def _neighbourhood(pixel: Int[np.ndarray, "n"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """The given pixels and the eight around each."""
    mark = np.zeros(shape, dtype=np.uint8)
    mark.ravel()[pixel] = 1
    return cv2.dilate(mark, np.ones((3, 3), np.uint8)).view(bool)
