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
    origin = points.uv_px[first].astype(np.float64)
    # Positions from the run's first point: picture coordinates would cancel in the sums.
    u = points.uv_px[:, 0] - np.repeat(origin[:, 0], support)
    v = points.uv_px[:, 1] - np.repeat(origin[:, 1], support)
    information = points.information.astype(np.float64)
    final = first + support - 1
    forward = np.stack([u[final], v[final]], axis=-1)

    root = np.sqrt(information)
    weight = root
    for last in (False, True):
        centre, direction = _weighted_line(u, v, weight, first, forward)
        offset_u, offset_v = (
            u - np.repeat(centre[:, 0], support),
            v - np.repeat(centre[:, 1], support),
        )
        way_u, way_v = np.repeat(direction[:, 0], support), np.repeat(direction[:, 1], support)
        across = offset_v * way_u - offset_u * way_v
        if not last:
            rms = np.sqrt(sums(across * across, first) / support)
            scale = 1 / (_ROBUST_SCALE_PX + 2 * rms)
            weight = root / np.square(1 + np.square(across * np.repeat(scale, support)))
    along = offset_u * way_u + offset_v * way_v

    total = sums(weight, first)
    if len(first):
        extent = np.stack(
            [np.minimum.reduceat(along, first), np.maximum.reduceat(along, first)], axis=-1
        )
    else:
        extent = np.zeros((0, 2))
    residual = np.sqrt(sums(weight * across * across, first) / total)
    kernel_variance = sums(weight * points.kernel_variance_px2, first) / total
    sharpness = sums(weight * points.sharpness, first) / total
    blur = (kernel_variance + 1) / np.maximum(sharpness, _LEAST_SHARPNESS) - kernel_variance
    # The profile's width at each point is that of the kernel there and of the edge's blur.
    variance = np.maximum(
        points.kernel_variance_px2 + np.repeat(blur, support), _LEAST_VARIANCE_PX2
    )
    return FittedLines(
        centre + origin,
        direction,
        extent,
        sums(points.strength * np.sqrt(2 * np.pi * variance), first) / support,
        sums(points.light_per_level, first) / support,
        blur,
        kernel_variance,
        1 / sums(information / variance**2, first),
        residual,
        _bow(along, across, weight, first, total),
        support,
        sums(points.snr2, first),
    )


def _weighted_line(
    u: Float[np.ndarray, "m"],
    v: Float[np.ndarray, "m"],
    weight: Float[np.ndarray, "m"],
    first: Int[np.ndarray, "r"],
    forward: Float[np.ndarray, "r 2"],
) -> tuple[np.ndarray, np.ndarray]:
    """Centre and direction of the line with the least weighted squared distances."""
    wu, wv = weight * u, weight * v
    total, su, sv, suu, suv, svv = (
        sums(moment, first) for moment in (weight, wu, wv, wu * u, wu * v, wv * v)
    )
    mean_u, mean_v = su / total, sv / total
    cov_uu, cov_uv = suu / total - mean_u**2, suv / total - mean_u * mean_v
    cov_vv = svv / total - mean_v**2
    angle = 0.5 * np.arctan2(2 * cov_uv, cov_uu - cov_vv)
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    backward = (direction * forward).sum(axis=-1) < 0
    direction[backward] *= -1
    return np.stack([mean_u, mean_v], axis=-1), direction


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
        sums(moment, first) / total
        for moment in (weighted, weighted * along, weighted * squared, weighted * across)
    )
    s2 = np.maximum(s2, 1e-12)
    free = np.maximum(s4 - s2**2 - s3**2 / s2, 1e-12)
    curvature = xs2 / free
    # Points spread evenly over a length L have s2 = L^2 / 12, and rise L^2 / 4 over the chord.
    return curvature * 3 * s2
