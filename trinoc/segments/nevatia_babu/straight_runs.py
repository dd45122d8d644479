"""One level of a picture: from grey levels to straight runs of edge points."""

import numpy as np
from jaxtyping import Bool, Int

from trinoc.numerics import members
from trinoc.segments.nevatia_babu.chains import ordered_chains
from trinoc.segments.nevatia_babu.edge_points import EdgePoints
from trinoc.segments.nevatia_babu.gradient import gradient_of
from trinoc.segments.nevatia_babu.linking import successors
from trinoc.segments.nevatia_babu.masks import GradientKernel
from trinoc.segments.nevatia_babu.polygon import split_chains
from trinoc.segments.nevatia_babu.pyramid import Level
from trinoc.segments.nevatia_babu.thinning import profile_across, thinned_pixels

# The end points of a run lie where the chain bends: the corner pulls them.
TRIMMED_POINTS = 1


def straight_runs(
    level: Level,
    kernel: GradientKernel,
    *,
    least_strength: float,
    tolerance_px: float,
    least_points: int,
    excluded: Bool[np.ndarray, "h w"] | None = None,
) -> tuple[EdgePoints, Int[np.ndarray, "r"]]:
    """(points, first): the points of straight runs one after another, and where each begins.

    `least_strength` is that of a point, in grey levels per pixel of the full picture,
    `tolerance_px` the largest deviation of a run from its chord. Runs of fewer than
    `least_points` points are left out, and pixels that are `excluded`.
    """
    levels, light = level.picture.levels, level.picture.light
    pixels = thinned_pixels(levels, kernel, least_strength * level.spacing_px, excluded)
    order, starts = ordered_chains(successors(pixels, levels.shape), least_points)
    start, stop = split_chains(pixels.uv_px[order], starts, tolerance_px, least_points)
    index, _, first = members(start + TRIMMED_POINTS, stop - TRIMMED_POINTS)
    points = EdgePoints.of_level(pixels := pixels.take(order[index]), level)
    if not level.picture.is_linear:
        in_light = profile_across(gradient_of(light, kernel), pixels)
        points = points.placed_in_light(in_light / np.float32(level.spacing_px))
    return points, first
