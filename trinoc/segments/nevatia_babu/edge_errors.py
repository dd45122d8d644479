"""What disturbs the place of a segment beyond the noise of the picture."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Shaped

from trinoc.numerics import sums
from trinoc.segments.nevatia_babu.accept import BOW_OF_MIDDLE
from trinoc.segments.nevatia_babu.edge_interference import Overlaps
from trinoc.segments.nevatia_babu.edge_points import EdgePoints
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.shifts import Shifts
from trinoc.segments.tuning import DEFAULT, ErrorTuning

_PIXEL_VARIANCE = 1 / 12
_LAST_POINTS = 5


class ErrorModel(NamedTuple):
    """Of each line, what besides noise may have moved it.

    Fields
    ------
    pull_px : (r,) mean shift of the points that was ascribed to neighbours.
    crowded : (r,) share of the points that have a neighbouring line within reach.
    widening_px : (r,) root of the variance by which the profile is wider than the typical one.
    saturated : (r,) share of the points whose bright side is saturated.
    sagitta_px : (r,) deviation from straightness that noise does not explain.
    scatter_px : (r,) root mean square distance of the points from the line, beyond what noise
        explains.
    off_px : (r, 2) how far the last points of each end lie off the line, where noise does not
        explain it: a neighbour has them.
    """

    pull_px: Float[np.ndarray, "r"]
    crowded: Float[np.ndarray, "r"]
    widening_px: Float[np.ndarray, "r"]
    saturated: Float[np.ndarray, "r"]
    sagitta_px: Float[np.ndarray, "r"]
    scatter_px: Float[np.ndarray, "r"]
    off_px: Float[np.ndarray, "r 2"]


def error_model(
    grey: Float[np.ndarray, "h w"],
    white: float,
    measured: EdgePoints,
    cleaned: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    found: Overlaps,
    usual_blur_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> ErrorModel:
    """Compare the points as measured and after neighbours were taken out.

    `lines` are fitted to the cleaned points, which lie line after line from first[k] on.
    """
    bow = np.abs(lines.sagitta_px)
    noise_bow = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    count = lines.support.astype(np.float64)
    noise_of_point = lines.variance_middle_px2 * count
    shift = (cleaned.uv_px - measured.uv_px).astype(np.float64)
    near = np.zeros(len(measured.strength))
    near[found.point] = 1.0
    # A saturated edge looks sharper than it is.
    blur = np.sqrt(np.maximum(lines.blur_px2, usual_blur_px2) + _PIXEL_VARIANCE)
    beside = np.maximum(
        tuning.bright_side_px * measured.spacing_px,
        np.repeat(tuning.bright_side_widths * blur, lines.support).astype(np.float32),
    )
    bright = measured.sample_px + beside[:, None] * measured.normal
    column, row = np.rint(bright).astype(np.int64).T
    height, width = grey.shape
    level = grey[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return ErrorModel(
        sums(np.hypot(shift[:, 0], shift[:, 1]), first) / count,
        sums(near, first) / count,
        np.sqrt(np.maximum(lines.blur_px2 - usual_blur_px2, 0.0)),
        sums((level >= white).astype(np.float64), first) / count,
        np.where(bow > tuning.bow_sigmas * noise_bow, bow, 0.0),
        np.sqrt(np.maximum(lines.residual_px**2 - tuning.scatter_noise * noise_of_point, 0.0)),
        _off_line(cleaned, first, lines, tuning.off_sigmas * np.sqrt(noise_of_point)),
    )


def _off_line(
    points: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    least_px: Float[np.ndarray, "r"],
) -> Float[np.ndarray, "r 2"]:
    """(r, 2) mean distance of the last points at either end from their line.

    0 where it is less than `least_px` over the root of their number.
    """
    count = np.minimum(_LAST_POINTS, lines.support)
    steps = np.arange(_LAST_POINTS)
    within = steps < count[:, None]
    begin, end = first[:, None] + steps, (first + lines.support - 1)[:, None] - steps
    index = np.where(within[:, None], np.stack([begin, end], axis=1), first[:, None, None])
    offset = points.uv_px[index] - lines.centre_px[:, None, None]
    way = lines.direction[:, None, None]
    across = offset[..., 1] * way[..., 0] - offset[..., 0] * way[..., 1]
    mean = np.abs((across * within[:, None]).sum(axis=2)) / count[:, None]
    return np.where(mean > (least_px / np.sqrt(count))[:, None], mean, 0.0)


def inflate_variance(
    disturbed: ErrorModel,
    noise_px2: Float[np.ndarray, "r"],
    saturated: Shifts,
    shaded: Shifts,
    tuning: ErrorTuning = DEFAULT.errors,
) -> tuple[Float[np.ndarray, "r"], Shaped[np.ndarray, "r"]]:
    """(variance, reason): of each line's place across it, and what added most to it.

    `noise_px2` is the variance from noise alone. The reason is "neighbour", "wide", "bent",
    "saturated" or "shaded" where that adds more than noise does, and "" elsewhere. The variance
    leaves out what moves a line as a whole.
    """
    parts = {
        "neighbour": np.hypot(
            tuning.pull_share * disturbed.pull_px,
            tuning.crowd_px * np.clip(disturbed.crowded - tuning.crowd_from, 0.0, None),
        ),
        "wide": tuning.wide_share * np.clip(disturbed.widening_px - tuning.wide_from_px, 0.0, None),
        "bent": np.hypot(
            tuning.bow_share * disturbed.sagitta_px, tuning.scatter_share * disturbed.scatter_px
        ),
    }
    squares = np.square(np.stack(list(parts.values())))
    whole = [shifts.variance_px2 + shifts.uneven_px2 for shifts in (saturated, shaded)]
    all_parts = np.concatenate([squares, whole])
    most = all_parts.argmax(axis=0)
    names = np.array([*parts, "saturated", "shaded"])
    reasons = np.where(all_parts.max(axis=0) > noise_px2, names[most], "")
    uneven_px2 = saturated.uneven_px2 + shaded.uneven_px2
    return noise_px2 + uneven_px2 + squares.sum(axis=0), reasons
