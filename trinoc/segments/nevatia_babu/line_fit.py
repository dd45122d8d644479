"""Straight lines through runs of edge points, and collinear lines joined across gaps.

Total least squares, weighted by edge strength.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.image.step_edge import height_of_step
from trinoc.numerics.joins import near_pairs
from trinoc.numerics.tables import take_rows
from trinoc.segments.nevatia_babu.chains import order_chains
from trinoc.segments.nevatia_babu.edge_points import Runs
from trinoc.segments.nevatia_babu.endpoints import Pieces
from trinoc.segments.tuning import DEFAULT, EndpointTuning, ScaleTuning, SegmentTuning

_LEAST_VARIANCE_PX2 = 1.0  # numerical: a guard where noise leaves no width
_LEAST_SHARPNESS = 0.01  # numerical: a guard of a division


class FittedLines(NamedTuple):
    """Lines fitted to runs of edge points, one line for each run.

    Attributes
    ----------
    centre_px : (r, 2)
        Weighted mean of the points.
    direction : (r, 2)
        Unit vector along the line, with the darker side on the right.
    extent_px : (r, 2)
        Positions of the first and the last point along the line, from the centre.
    contrast : (r,)
        Mean height of the step, grey levels.
    light_per_level : (r,)
        Mean gradient of the light over gradient of the grey levels.
    blur_px2 : (r,)
        Mean variance of the edge's blur.
    kernel_variance_px2 : (r,)
        Mean variance of the smoothing by the kernel.
    variance_middle_px2 : (r,)
        Variance of the line's midpoint across the line, due to noise.
    residual_px : (r,)
        Root mean square distance of the points from the line.
    sagitta_px : (r,)
        Bow of the points: signed height of the best parabola over its chord.
    support : (r,)
        Number of points.
    snr2 : (r,)
        Sum of `EdgePoints.snr2` over the points.
    """

    centre_px: Float[np.ndarray, "r 2"]
    direction: Float[np.ndarray, "r 2"]
    extent_px: Float[np.ndarray, "r 2"]
    contrast: Float[np.ndarray, "r"]
    light_per_level: Float[np.ndarray, "r"]
    blur_px2: Float[np.ndarray, "r"]
    kernel_variance_px2: Float[np.ndarray, "r"]
    variance_middle_px2: Float[np.ndarray, "r"]
    residual_px: Float[np.ndarray, "r"]
    sagitta_px: Float[np.ndarray, "r"]
    support: Int[np.ndarray, "r"]
    snr2: Float[np.ndarray, "r"]

    @property
    def pieces(self) -> Pieces:
        """The part of each line from its first to its last point."""
        return Pieces(self.centre_px, self.direction, self.extent_px)


def fit_lines(runs: Runs, tuning: ScaleTuning = DEFAULT.scales) -> FittedLines:
    """Fit a line to each run of edge points.

    Points are weighted by their strength. A second pass reduces the weight of points far from the
    line of the first pass, for example where a chain bends at a corner.
    """
    points = runs.points
    origin, chord, x, y = _in_frames_of_chords(runs)
    root = np.sqrt(points.information)
    weight = root
    for is_last_pass in (False, True):
        mean, turn = _fit_weighted_line(runs, x, y, weight)
        cosine, sine = (runs.spread(part) for part in turn.T.astype(np.float32))
        off_x, off_y = (
            coordinate - runs.spread(part)
            for coordinate, part in zip((x, y), mean.T.astype(np.float32))
        )
        across = off_y * cosine - off_x * sine
        if not is_last_pass:
            rms = np.sqrt(runs.mean(across * across))
            scale = (1 / (tuning.robust_px + 2 * rms)).astype(np.float32)
            weight = root / np.square(1 + np.square(across * runs.spread(scale)))
    along = off_x * cosine + off_y * sine

    total = runs.total(weight)
    extent = np.stack([end.reduceat(along, runs.first) for end in (np.minimum, np.maximum)], -1)
    residual = np.sqrt(runs.total(weight * across * across) / total)
    kernel_variance = runs.total(weight * points.kernel_variance_px2) / total
    sharpness = runs.total(weight * points.sharpness) / total
    blur = (kernel_variance + 1) / np.maximum(sharpness, _LEAST_SHARPNESS) - kernel_variance
    # Width of the profile at each point: kernel plus blur of the edge.
    variance = np.maximum(
        points.kernel_variance_px2 + runs.spread(blur.astype(np.float32)),
        np.float32(_LEAST_VARIANCE_PX2),
    )
    return FittedLines(
        origin + _rotate_to_picture(mean, chord),
        _rotate_to_picture(turn, chord),
        extent.astype(np.float64),
        runs.mean(height_of_step(points.strength, variance)),
        runs.mean(points.light_per_level),
        blur,
        kernel_variance,
        1 / runs.total(points.information / np.square(variance)),
        residual,
        _bow(runs, along, across, weight, total),
        runs.count,
        runs.total(points.snr2),
    )


def _in_frames_of_chords(runs: Runs) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Convert the points to coordinates x along and y across the chord of their run.

    The chord connects the first and the last point. Returns (origin, unit vector of the chord, x,
    y).

    Notes
    -----
    Origin and chord are in double precision. Sums of x and y can then use single precision: a line
    of 1,000 px is located to 1e-5 px.
    """
    uv_px, first = runs.points.uv_px, runs.first
    origin = uv_px[first].astype(np.float64)
    chord = uv_px[first + runs.count - 1] - origin
    length = np.hypot(chord[:, 0], chord[:, 1])
    chord = np.where(length[:, None] > 0, chord / np.maximum(length, 1e-9)[:, None], [1.0, 0.0])
    u, v = (uv_px[:, axis] - runs.spread(origin[:, axis]) for axis in (0, 1))
    cosine, sine = (runs.spread(part) for part in chord.T)
    x, y = u * cosine + v * sine, v * cosine - u * sine
    return origin, chord, x.astype(np.float32), y.astype(np.float32)


def _rotate_to_picture(xy: Float[np.ndarray, "r 2"], chord: Float[np.ndarray, "r 2"]) -> np.ndarray:
    """Rotate vectors from the frame of each chord (along, across) to the image."""
    u = xy[:, 0] * chord[:, 0] - xy[:, 1] * chord[:, 1]
    return np.stack([u, xy[:, 0] * chord[:, 1] + xy[:, 1] * chord[:, 0]], axis=-1)


def _fit_weighted_line(
    runs: Runs,
    x: Float[np.ndarray, "m"],
    y: Float[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
) -> tuple[np.ndarray, np.ndarray]:
    """Fit a line to each run by weighted total least squares. Returns (centre, direction)."""
    wx, wy = weight * x, weight * y
    total, sx, sy, sxx, sxy, syy = (
        runs.total(moment) for moment in (weight, wx, wy, wx * x, wx * y, wy * y)
    )
    mean_x, mean_y = sx / total, sy / total
    cov_xx, cov_xy = sxx / total - mean_x**2, sxy / total - mean_x * mean_y
    cov_yy = syy / total - mean_y**2
    angle = 0.5 * np.arctan2(2 * cov_xy, cov_xx - cov_yy)
    return np.stack([mean_x, mean_y], axis=-1), np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _bow(
    runs: Runs,
    along: Float[np.ndarray, "m"],
    across: Float[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
    total: Float[np.ndarray, "r"],
) -> Float[np.ndarray, "r"]:
    """Return the signed height of the best parabola over its chord, (r,) px.

    `along` and `across` are the coordinates of the points. The height follows from the part of
    along^2 that is orthogonal to 1 and along.
    """
    squared = along * along
    weighted = weight * squared
    s2, s3, s4, xs2 = (
        runs.total(moment) / total
        for moment in (weighted, weighted * along, weighted * squared, weighted * across)
    )
    s2 = np.maximum(s2, 1e-12)
    free = np.maximum(s4 - s2**2 - s3**2 / s2, 1e-12)
    curvature = xs2 / free
    # Points spread evenly over a length L have s2 = L^2 / 12, and rise L^2 / 4 over the chord.
    return curvature * 3 * s2


def merge_collinear(
    runs: Runs, lines: FittedLines, tolerance_px: float, tuning: SegmentTuning = DEFAULT
) -> tuple[Runs, FittedLines]:
    """Join collinear lines across small gaps, and fit the joined lines again. Returns (runs,
    lines).
    """
    successor = collinear_successors(lines, tolerance_px / 2, tuning.ends)
    line_order, begin = order_chains(successor)
    length = runs.count[line_order]
    before = np.cumsum(length) - length
    order = np.arange(length.sum()) - np.repeat(before - runs.first[line_order], length)
    merged = Runs.from_counts(runs.points.take(order), np.add.reduceat(length, begin))
    joined = np.diff(np.append(begin, len(length))) > 1
    return merged, refit_lines(merged, take_rows(lines, line_order[begin]), joined, tuning.scales)


def refit_lines(
    runs: Runs,
    lines: FittedLines,
    changed: Bool[np.ndarray, "r"],
    tuning: ScaleTuning = DEFAULT.scales,
) -> FittedLines:
    """Fit the runs in the mask `changed` again, and return all lines."""
    if changed.all() or not changed.any():
        return fit_lines(runs, tuning) if changed.any() else lines
    fields = [field.copy() for field in lines]
    for field, refitted in zip(fields, fit_lines(runs.take(changed), tuning), strict=True):
        field[changed] = refitted
    return FittedLines(*fields)


def collinear_successors(
    lines: FittedLines, tolerance_px: float, tuning: EndpointTuning = DEFAULT.ends
) -> Int[np.ndarray, "r"]:
    """Return the line that continues each line beyond a gap, (r,); -1 if there is none.

    Two lines continue each other if their dark sides are on the same side and the gap is at most
    `tuning.gap_px`. Both inner ends must lie within `tolerance_px` of the chord between the outer
    ends. A line has at most one predecessor and one successor, the nearest ones.
    """
    successor = np.full(len(lines.support), -1, dtype=np.int64)
    ends = lines.pieces.ends_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], tuning.gap_px)
    direction, next_direction = lines.direction[one], lines.direction[other]
    along = np.flatnonzero(
        direction[:, 0] * next_direction[:, 0] + direction[:, 1] * next_direction[:, 1]
        > np.cos(np.radians(tuning.parallel_deg))
    )
    one, other, gap = one[along], other[along], gap[along]
    chord = ends[other, 1] - ends[one, 0]
    length = np.linalg.norm(chord, axis=-1)
    normal = np.stack([-chord[:, 1], chord[:, 0]], -1) / np.maximum(length, 1e-9)[:, None]
    deviation = np.maximum(
        *(
            np.abs(offset[:, 0] * normal[:, 0] + offset[:, 1] * normal[:, 1])
            for offset in (ends[one, 1] - ends[one, 0], ends[other, 0] - ends[one, 0])
        )
    )
    part = lines.pieces.length_px
    longer_than_parts = length > np.maximum(part[one], part[other])
    allowed = (one != other) & (deviation < tolerance_px) & longer_than_parts
    one, other, gap = one[allowed], other[allowed], gap[allowed]
    for by_other in (False, True):
        side = other if by_other else one
        nearest = np.lexsort((gap, side))
        nearest = nearest[np.flatnonzero(np.diff(side[nearest], prepend=-1))]
        one, other, gap = one[nearest], other[nearest], gap[nearest]
    successor[one] = other
    return successor
