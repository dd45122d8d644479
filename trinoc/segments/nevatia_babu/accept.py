"""Which fitted lines are sharp, straight edges of the scene, and more than noise.

The evidence of a line is E = n (m / s)^2 for n edge points of mean strength m, where s is
the standard deviation of the gradient that noise alone gives. On pictures of white noise the
number of lines per megapixel whose evidence exceeds E falls as RATE exp(-E / DECAY); both
numbers were fitted to such pictures (benchmarks/segments.py repeats the measurement) and
hold for point thresholds of 2.5 s and above.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.numerics import near_pairs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.tuning import DEFAULT, AcceptTuning

_RATE_PER_MEGAPIXEL, _DECAY = 4.2e4, 12.0
# Noise moves the bow of a line this many times more than its middle: the parabola has to be
# told from the line.
BOW_OF_MIDDLE = float(np.sqrt(11.25))
# Points, and square of strength over noise per point, of lines whose width is well measured.
_LONG, _CLEAR_SNR2 = 15, 100.0
# Root mean square distance of a parabola from its best line, over its bow.
_RMS_OF_BOW = float(np.sqrt(4 / 45))


def typical_blur(lines: FittedLines) -> float:
    """Variance of the blur of the picture's edges, in px^2: the median, long lines weigh more."""
    if len(lines.support) == 0:
        return 0.0
    return max(_weighted_quantiles(lines.blur_px2, lines.support, (0.5,))[0], 0.0)


def _weighted_quantiles(
    values: Float[np.ndarray, "r"], weight: Int[np.ndarray, "r"], shares: Sequence[float]
) -> list[float]:
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    return values[order[np.searchsorted(total, np.array(shares) * total[-1])]].tolist()


def is_sharp(
    lines: FittedLines, usual_px2: float, tuning: AcceptTuning = DEFAULT.accept
) -> Bool[np.ndarray, "r"]:
    """Edges that are no soft shadows: of about the image's typical width, or narrow anyway.

    Where the edges of a picture have many widths, as with depth or texture, a wide one is no
    evidence of a shadow: the limit follows the spread of the widths.
    """
    profile = lines.kernel_variance_px2 + lines.blur_px2
    typical = lines.kernel_variance_px2 + usual_px2
    # Of long, clear lines: the widths of others scatter by noise.
    clear = (lines.support >= _LONG) & (lines.snr2 > _CLEAR_SNR2 * lines.support)
    ratio = tuning.soft_ratio
    if clear.any():
        widths = (profile / typical)[clear]
        low, high = _weighted_quantiles(widths, lines.support[clear], (0.25, 0.75))
        spread = 1 + tuning.soft_spreads * (high - low) / 2
        ratio = max(ratio, min(spread, tuning.soft_most))
    usual = ratio * typical
    return profile <= np.maximum(usual, lines.kernel_variance_px2 + tuning.sharp_px2)


def is_straight(
    lines: FittedLines, width_px: int, tuning: AcceptTuning = DEFAULT.accept
) -> Bool[np.ndarray, "r"]:
    """Edges that are no arcs, such as the rims of cylinders.

    The points of an arc lie on it: where a curve explains little of how they scatter about the
    line, and bows it little, a long line counts as straight.
    """
    length = np.ptp(lines.extent_px, axis=1)
    bow = np.abs(lines.sagitta_px)
    sigma = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    radius = length**2 / np.maximum(8 * bow, 1e-9)
    small = radius < tuning.arc_radius_of_width * width_px
    arc = (bow > tuning.arc_bow_px) & (bow > 3 * sigma) & small
    curved = np.flatnonzero((bow > tuning.least_bow_px) & (bow > 2 * sigma))
    arc[curved] |= _bends_on(lines, tuning)[curved]
    explained = np.square(_RMS_OF_BOW * bow) / np.maximum(np.square(lines.residual_px), 1e-12)
    ragged = (explained < tuning.arc_explains) & (bow < tuning.arc_bow_of_length * length)
    return ~arc | (ragged & (length > tuning.arc_least_px))


def _bends_on(lines: FittedLines, tuning: AcceptTuning) -> Bool[np.ndarray, "r"]:
    """Whether a piece before or after continues the curve of each line."""
    bends = np.zeros(len(lines.support), dtype=bool)
    ends = lines.pieces.ends_px
    one, other, gap = near_pairs(ends[:, 1], ends[:, 0], tuning.next_px)
    a, b = lines.direction[one], lines.direction[other]
    sine, cosine = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]
    turn = np.arctan2(sine, cosine)
    length = np.ptp(lines.extent_px, axis=1)
    between = (length[one] + length[other]) / 2 + gap
    curvature = 8 * lines.sagitta_px / np.maximum(length, 1.0) ** 2
    least, most = np.radians(tuning.turn_deg)
    turning = (np.abs(turn) > least) & (np.abs(turn) < most) & (one != other)
    for line in (one, other):
        ratio = turn / (curvature[line] * between + 1e-12)
        promised = (ratio > 1 / tuning.turn_ratio) & (ratio < tuning.turn_ratio)
        bends[line[turning & promised]] = True
    return bends


def least_snr2(false_alarms: float, pixels: int) -> float:
    """Evidence that noise exceeds `false_alarms` times, on average, in so many pixels."""
    return _DECAY * float(np.log(max(_RATE_PER_MEGAPIXEL * pixels / 1e6 / false_alarms, 1.0)))
