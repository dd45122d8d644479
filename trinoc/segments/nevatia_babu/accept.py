"""Acceptance of fitted lines: sharp, straight edges with more evidence than noise.

The evidence of a line is E = n (m / s)^2. n is the number of edge points, m their mean strength, s
the standard deviation of the gradient noise. On images of white noise, the number of lines per
megapixel with evidence above E is RATE exp(-E / DECAY). Both numbers were fitted to such images
(benchmarks/segments.py repeats the measurement). They are valid for point thresholds of 2.5 s and
above.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics.joins import near_pairs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT, AcceptTuning

_RATE_PER_MEGAPIXEL, _DECAY = 4.2e4, 12.0  # numerical: fitted to white noise, as above
# Ratio of the bow's standard deviation by noise to that of the middle: line and parabola are
# estimated together.
BOW_OF_MIDDLE = float(np.sqrt(11.25))  # numerical: moments of a parabola
# Root mean square distance of a parabola from its best line, over its bow.
_RMS_OF_BOW = float(np.sqrt(4 / 45))  # numerical: moments of a parabola


def typical_blur(lines: FittedLines) -> float:
    """Return the typical blur variance of the image's edges, px^2.

    The value is the median over the lines, weighted by their numbers of points.
    """
    if len(lines.support) == 0:
        return 0.0
    return max(_quantile(lines.blur_px2, lines.support, 0.5), 0.0)


def _quantile(values: Float[np.ndarray, "r"], weights: Int[np.ndarray, "r"], share: float) -> float:
    """Return a weighted quantile: the smallest value whose cumulative weight reaches the share."""
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(total, share * total[-1])]])


def is_sharp(
    lines: FittedLines, usual_px2: float, tuning: AcceptTuning = DEFAULT.accept
) -> Bool[np.ndarray, "r"]:
    """Return the mask of the edges that are not much wider than usual, (r,). Others are soft
    shadows.

    `usual_px2` is the typical blur variance.

    Notes
    -----
    In an image with many edge widths (depth, texture), a wide edge is no evidence of a shadow. The
    limit therefore grows with the spread of the widths. The spread is measured on the narrower half
    of lines with large evidence, because shadows are in the wider half. Faint lines are not used,
    because noise changes their widths.
    """
    ratio = lines.kernel_variance_px2 + lines.blur_px2
    ratio /= lines.kernel_variance_px2 + usual_px2
    limit = tuning.soft_ratio
    clear = lines.snr2 > np.square(tuning.clear_ratio) * lines.support
    if clear.any():
        low, middle = (_quantile(ratio[clear], lines.support[clear], q) for q in (0.25, 0.5))
        limit = max(limit, 1 + tuning.soft_spreads * (middle - low))
    return ratio <= limit


def is_straight(lines: FittedLines, tuning: AcceptTuning = DEFAULT.accept) -> Bool[np.ndarray, "r"]:
    """Return the mask of the lines that are not chords of curves, such as rims of cylinders, (r,).

    A line is a chord under two conditions. A neighbouring line continues its curve. The curve
    explains most of its residuals, or its bow is large.

    Notes
    -----
    A bow alone is not enough, because lenses bend straight edges and real edges are slightly bent.
    """
    length = lines.pieces.length_px
    bow = np.abs(lines.sagitta_px)
    sigma = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    arc = (bow > 2 * sigma) & _continues_curve(lines, tuning)
    explained = np.square(_RMS_OF_BOW * bow) / np.maximum(np.square(lines.residual_px), 1e-12)
    ragged = (explained < tuning.arc_explains) & (bow < tuning.arc_bow_of_length * length)
    return ~arc | ragged


def _continues_curve(lines: FittedLines, tuning: AcceptTuning) -> Bool[np.ndarray, "r"]:
    """Return the mask of the lines whose neighbouring line continues the same curve, (r,).

    The angle between the two lines must agree with the angle that the line's bow predicts.
    """
    bends = np.zeros(len(lines.support), dtype=bool)
    ends = lines.pieces.ends_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], tuning.next_px)
    direction, next_direction = lines.direction[one], lines.direction[other]
    sine, cosine = (
        direction[:, 0] * next_direction[:, 1] - direction[:, 1] * next_direction[:, 0],
        direction[:, 0] * next_direction[:, 0] + direction[:, 1] * next_direction[:, 1],
    )
    turn = np.arctan2(sine, cosine)
    length = lines.pieces.length_px
    between = (length[one] + length[other]) / 2 + gap
    curvature = 8 * lines.sagitta_px / np.maximum(length, 1.0) ** 2
    smallest_turn, largest_turn = np.radians(tuning.turn_deg)
    turning = (np.abs(turn) > smallest_turn) & (np.abs(turn) < largest_turn) & (one != other)
    for line in (one, other):
        ratio = turn / (curvature[line] * between + 1e-12)
        is_predicted = (ratio > 1 / tuning.turn_ratio) & (ratio < tuning.turn_ratio)
        bends[line[turning & is_predicted]] = True
    return bends


def least_snr2(false_alarms: float, pixels: int) -> float:
    """Return the smallest `FittedLines.snr2` of an accepted line, for an image of `pixels` pixels.

    On average, noise alone causes `false_alarms` lines with a larger value.
    """
    return _DECAY * float(np.log(max(_RATE_PER_MEGAPIXEL * pixels / 1e6 / false_alarms, 1.0)))
