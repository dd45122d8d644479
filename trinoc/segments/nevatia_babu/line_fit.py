"""Straight lines through runs of edge points: total least squares, weighted by edge strength."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics import sums
from trinoc.segments.nevatia_babu.edge_points import EdgePoints

# Scale s of the weight 1 / (1 + (r / s)^2)^2, where the points fit well: a quarter at r = s, a
# hundredth at r = 3 s.
_ROBUST_SCALE_PX = 0.3
_LEAST_VARIANCE_PX2 = 1.0
_LEAST_SHARPNESS = 0.01


class FittedLines(NamedTuple):
    """Lines through runs of edge points, in the order of the runs.

    Fields
    ------
    centre_px : (r, 2) weighted mean of the points.
    direction : (r, 2) unit vector, with the darker side on the right.
    extent_px : (r, 2) first and last point along the line, from the centre.
    contrast : (r,) mean height of the step, in grey levels.
    light_per_level : (r,) mean slope of the light over that of the grey levels.
    blur_px2 : (r,) mean variance of the edge's own blur.
    kernel_variance_px2 : (r,) mean variance of the smoothing by the kernel.
    variance_middle_px2 : (r,) variance that noise gives the middle of the line across it.
    residual_px : (r,) root mean square distance of the points from the line.
    sagitta_px : (r,) largest deviation of a parabola through the points from its chord, signed.
    support : (r,) number of points.
    snr2 : (r,) sum of the points' evidence.
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

    def take(self, which: np.ndarray) -> "FittedLines":
        """The lines at the given indices or where the mask is true."""
        return FittedLines(*(field[which] for field in self))

    def replaced(self, which: Bool[np.ndarray, "r"], other: "FittedLines") -> "FittedLines":
        """The same with `other` in place of the lines where the mask is true."""
        fields = [field.copy() for field in self]
        for field, new in zip(fields, other, strict=True):
            field[which] = new
        return FittedLines(*fields)

    @property
    def endpoints_px(self) -> Float[np.ndarray, "r 2 2"]:
        """(r, 2, 2) the two ends of each line."""
        return self.centre_px[:, None] + self.extent_px[:, :, None] * self.direction[:, None]


def fit_lines(points: EdgePoints, first: Int[np.ndarray, "r"]) -> FittedLines:
    """Fit a line to each run of `points`: run k begins at first[k] and ends where k + 1 begins.

    Points are weighted by their strength; a second pass weighs down those off the first
    line, as where a chain turns into a corner.
    """
    support = np.diff(np.append(first, len(points.strength)))
    origin, chord, x, y = _in_frames_of_chords(points.uv_px, first, support)
    information = points.information
    root = np.sqrt(information)
    weight = root
    for last in (False, True):
        mean, turn = _weighted_line(x, y, weight, first)
        cosine, sine = (np.repeat(part, support) for part in turn.T.astype(np.float32))
        off_x, off_y = (
            of - np.repeat(part, support)
            for of, part in ((x, mean[:, 0].astype(np.float32)), (y, mean[:, 1].astype(np.float32)))
        )
        across = off_y * cosine - off_x * sine
        if not last:
            rms = np.sqrt(sums(across * across, first) / support)
            scale = (1 / (_ROBUST_SCALE_PX + 2 * rms)).astype(np.float32)
            weight = root / np.square(1 + np.square(across * np.repeat(scale, support)))
    along = off_x * cosine + off_y * sine

    total = _totals(weight, first)
    if len(first):
        extent = np.stack(
            [np.minimum.reduceat(along, first), np.maximum.reduceat(along, first)], axis=-1
        )
    else:
        extent = np.zeros((0, 2))
    residual = np.sqrt(_totals(weight * across * across, first) / total)
    kernel_variance = _totals(weight * points.kernel_variance_px2, first) / total
    sharpness = _totals(weight * points.sharpness, first) / total
    blur = (kernel_variance + 1) / np.maximum(sharpness, _LEAST_SHARPNESS) - kernel_variance
    # The profile's width at each point is that of the kernel there and of the edge's blur.
    variance = np.maximum(
        points.kernel_variance_px2 + np.repeat(blur.astype(np.float32), support),
        np.float32(_LEAST_VARIANCE_PX2),
    )
    height = points.strength * np.sqrt(np.float32(2 * np.pi) * variance)
    return FittedLines(
        origin + _turned(mean, chord),
        _turned(turn, chord),
        extent.astype(np.float64),
        _totals(height, first) / support,
        _totals(points.light_per_level, first) / support,
        blur,
        kernel_variance,
        1 / _totals(information / np.square(variance), first),
        residual,
        _bow(along, across, weight, first, total),
        support,
        _totals(points.snr2, first),
    )


def _in_frames_of_chords(
    uv_px: Float[np.ndarray, "m 2"], first: Int[np.ndarray, "r"], support: Int[np.ndarray, "r"]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(origin, chord, x, y): the points along and across the unit vector from first to last point.

    From the first point, in double precision. What lies near an axis can then be summed up in
    single precision: a line of 1,000 px is placed to 1e-5 px.
    """
    origin = uv_px[first].astype(np.float64)
    chord = uv_px[first + support - 1] - origin
    length = np.hypot(chord[:, 0], chord[:, 1])
    chord = np.where(length[:, None] > 0, chord / np.maximum(length, 1e-9)[:, None], [1.0, 0.0])
    u = uv_px[:, 0] - np.repeat(origin[:, 0], support)
    v = uv_px[:, 1] - np.repeat(origin[:, 1], support)
    cosine, sine = (np.repeat(part, support) for part in chord.T)
    x, y = u * cosine + v * sine, v * cosine - u * sine
    return origin, chord, x.astype(np.float32), y.astype(np.float32)


def _turned(xy: Float[np.ndarray, "r 2"], chord: Float[np.ndarray, "r 2"]) -> np.ndarray:
    """Vectors in the frames of chords as vectors of the picture."""
    u = xy[:, 0] * chord[:, 0] - xy[:, 1] * chord[:, 1]
    return np.stack([u, xy[:, 0] * chord[:, 1] + xy[:, 1] * chord[:, 0]], axis=-1)


def _totals(values: Float[np.ndarray, "m"], first: Int[np.ndarray, "r"]) -> np.ndarray:
    return sums(values, first).astype(np.float64)


def _weighted_line(
    x: Float[np.ndarray, "m"],
    y: Float[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
    first: Int[np.ndarray, "r"],
) -> tuple[np.ndarray, np.ndarray]:
    """Centre and forward direction of the line with the least weighted squared distances."""
    wx, wy = weight * x, weight * y
    total, sx, sy, sxx, sxy, syy = (
        _totals(moment, first) for moment in (weight, wx, wy, wx * x, wx * y, wy * y)
    )
    mean_x, mean_y = sx / total, sy / total
    cov_xx, cov_xy = sxx / total - mean_x**2, sxy / total - mean_x * mean_y
    cov_yy = syy / total - mean_y**2
    angle = 0.5 * np.arctan2(2 * cov_xy, cov_xx - cov_yy)
    return np.stack([mean_x, mean_y], axis=-1), np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _bow(
    along: Float[np.ndarray, "m"],
    across: Float[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
    first: Int[np.ndarray, "r"],
    total: Float[np.ndarray, "r"],
) -> Float[np.ndarray, "r"]:
    """Height of the best parabola over its chord, the line being the best straight one.

    With t along the line, the part of t^2 that is orthogonal to 1 and t carries the sagitta.
    """
    squared = along * along
    weighted = weight * squared
    s2, s3, s4, xs2 = (
        _totals(moment, first) / total
        for moment in (weighted, weighted * along, weighted * squared, weighted * across)
    )
    s2 = np.maximum(s2, 1e-12)
    free = np.maximum(s4 - s2**2 - s3**2 / s2, 1e-12)
    curvature = xs2 / free
    # Points spread evenly over a length L have s2 = L^2 / 12, and rise L^2 / 4 over the chord.
    return curvature * 3 * s2
