"""Straight runs of both levels, each level where it is the better one."""

import cv2
import numpy as np
from jaxtyping import Bool, Int

from trinoc.numerics import members, sums
from trinoc.segments.nevatia_babu.edge_points import EdgePoints
from trinoc.segments.nevatia_babu.masks import GradientKernel
from trinoc.segments.nevatia_babu.pyramid import Level, half_level
from trinoc.segments.nevatia_babu.straight_runs import straight_runs
from trinoc.segments.tuning import DEFAULT, ScaleTuning


def runs_of_both_scales(
    fine: Level,
    kernel: GradientKernel,
    tolerance_px: float,
    least_contrast: float,
    tuning: ScaleTuning = DEFAULT.scales,
) -> tuple[EdgePoints, Int[np.ndarray, "r"]]:
    """(points, first): points of straight runs one after another, and where each run begins.

    Runs that stand out clearly at full resolution are taken from there. Elsewhere the half
    resolution is searched; faint runs of the full one remain where it finds nothing. In
    pictures of so little noise that all runs stand out, the half resolution is left out.
    """
    least_fine = _least_strength(fine, tuning.fine_threshold, least_contrast, tuning)
    points, first = straight_runs(
        fine,
        kernel,
        least_strength=least_fine,
        tolerance_px=tolerance_px,
        least_points=tuning.least_fine,
    )
    if least_fine > tuning.clear_ratio * fine.sigma_strength:
        # So little noise that every point stands out clearly.
        return points, first
    half = half_level(fine, kernel)
    support = np.diff(np.append(first, len(points.strength)))
    clear = sums(points.snr2, first) > tuning.clear_ratio**2 * support
    half_pixel, shape = _half_pixel(points, half), half.picture.levels.shape
    taken = _neighbourhood(half_pixel[np.repeat(clear, support)], shape)
    coarse, coarse_first = straight_runs(
        half,
        kernel,
        least_strength=_least_strength(half, tuning.coarse_threshold, least_contrast, tuning),
        tolerance_px=tolerance_px,
        least_points=tuning.least_coarse,
        excluded=taken,
    )
    seen_again = _neighbourhood(_half_pixel(coarse, half), shape).ravel()[half_pixel]
    keep = clear | (sums(seen_again.astype(np.float64), first) < 0.5 * support)
    index, _, fine_first = members(first[keep], (first + support)[keep])
    both = zip(points.take(index), coarse, strict=True)
    points = EdgePoints(*(np.concatenate(field) for field in both))
    return points, np.concatenate([fine_first, coarse_first + len(index)])


def _least_strength(
    level: Level, threshold: float, least_contrast: float, tuning: ScaleTuning
) -> float:
    """Strength below which a point is noise, or belongs to a step of too little contrast."""
    faint = least_contrast / np.sqrt(2 * np.pi * (level.kernel_variance_px2 + 1.0))
    return max(threshold * level.sigma_strength, tuning.faint_share * float(faint))


def _half_pixel(points: EdgePoints, half: Level) -> Int[np.ndarray, "n"]:
    """Index, in the half picture, of the pixel that holds each point."""
    height, width = half.picture.levels.shape
    column, row = (points.sample_px // 2).astype(np.int64).T
    return np.minimum(row, height - 1) * width + np.minimum(column, width - 1)


def _neighbourhood(pixel: Int[np.ndarray, "n"], shape: tuple[int, int]) -> Bool[np.ndarray, "h w"]:
    """The given pixels and the eight around each."""
    mark = np.zeros(shape, dtype=np.uint8)
    mark.ravel()[pixel] = 1
    return cv2.dilate(mark, np.ones((3, 3), np.uint8)).view(bool)
