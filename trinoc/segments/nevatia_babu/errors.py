"""What the noise of the picture makes of a line's place, and what disturbs it beyond."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image import Light, nearest_levels
from trinoc.segments.nevatia_babu.accept import BOW_OF_MIDDLE
from trinoc.segments.nevatia_babu.edge_points import EdgePoints, Runs
from trinoc.segments.nevatia_babu.interference import Overlaps
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.shading import Shifts
from trinoc.segments.tuning import DEFAULT, ErrorTuning

_PIXEL_VARIANCE = 1 / 12
_LAST_POINTS = 5
# Noise also enters through the choice of points; the share was measured on single edges.
NOISE_EXCESS = 1.2
# What the model leaves out even on a perfect edge (sampling, kernel shape, rounding): a part that
# is common to the whole edge, and a part per pixel of length that averages out.
MODEL_SIGMA_PX, MODEL_SIGMA_PER_PIXEL = 0.01, 0.11


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
    picture: Light,
    measured: EdgePoints,
    cleaned: Runs,
    lines: FittedLines,
    found: Overlaps,
    usual_blur_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> ErrorModel:
    """Compare the points as measured and after neighbours were taken out.

    `lines` are fitted to the cleaned points.
    """
    bow = np.abs(lines.sagitta_px)
    noise_bow = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    noise_of_point = lines.variance_middle_px2 * lines.support
    shift = (cleaned.points.uv_px - measured.uv_px).astype(np.float64)
    near = np.zeros(len(measured.strength))
    near[found.point] = 1.0
    # A saturated edge looks sharper than it is.
    blur = np.sqrt(np.maximum(lines.blur_px2, usual_blur_px2) + _PIXEL_VARIANCE)
    beside = np.maximum(
        tuning.bright_side_px * measured.spacing_px,
        cleaned.spread(tuning.bright_side_widths * blur).astype(np.float32),
    )
    bright = measured.sample_px + beside[:, None] * measured.normal
    level = nearest_levels(picture.levels, *bright.T)
    return ErrorModel(
        cleaned.mean(np.hypot(shift[:, 0], shift[:, 1])),
        cleaned.mean(near),
        np.sqrt(np.maximum(lines.blur_px2 - usual_blur_px2, 0.0)),
        cleaned.mean((level >= picture.white).astype(np.float64)),
        np.where(bow > tuning.bow_sigmas * noise_bow, bow, 0.0),
        np.sqrt(np.maximum(lines.residual_px**2 - tuning.scatter_noise * noise_of_point, 0.0)),
        _off_line(cleaned, lines, tuning.off_sigmas * np.sqrt(noise_of_point)),
    )


def _off_line(
    runs: Runs, lines: FittedLines, least_px: Float[np.ndarray, "r"]
) -> Float[np.ndarray, "r 2"]:
    """(r, 2) mean distance of the last points at either end from their line.

    0 where it is less than `least_px` over the root of their number.
    """
    first, count = runs.first[:, None], np.minimum(_LAST_POINTS, runs.count)[:, None]
    steps = np.arange(_LAST_POINTS)
    ends = np.stack([first + steps, first + runs.count[:, None] - 1 - steps], axis=1)
    within = (steps < count)[:, None]
    offset = runs.points.uv_px[np.where(within, ends, first[:, None])]
    offset = offset - lines.centre_px[:, None, None]
    way = lines.direction[:, None, None]
    across = offset[..., 1] * way[..., 0] - offset[..., 0] * way[..., 1]
    mean = np.abs((across * within).sum(axis=2)) / count
    return np.where(mean > least_px[:, None] / np.sqrt(count), mean, 0.0)


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


def noise_variance(
    variance_middle_px2: Float[np.ndarray, "r"], length_px: Float[np.ndarray, "r"]
) -> Float[np.ndarray, "r"]:
    """(r,) variance of a line's middle across it, where nothing but noise disturbs it."""
    model = MODEL_SIGMA_PX**2 + MODEL_SIGMA_PER_PIXEL**2 / np.maximum(length_px, 1.0)
    return NOISE_EXCESS * variance_middle_px2 + model


def end_covariances(
    direction: Float[np.ndarray, "r 2"],
    variance_middle: Float[np.ndarray, "r"],
    common_px2: Float[np.ndarray, "r"],
    off_px2: Float[np.ndarray, "r 2"],
    sigma_along_px: Float[np.ndarray, "r 2"],
) -> Float[np.ndarray, "r 4 4"]:
    """(r, 4, 4) covariance of the ends (u1, v1, u2, v2).

    A line fitted to points spread evenly over its length L has an angle of variance
    12 / L^2 times that of its middle: each end has four times the variance across, and
    the two are correlated by -1/2. What moves the line as a whole, of variance `common_px2`,
    moves both ends alike; `off_px2` is what each end may be off by itself. Along the line the two
    ends are independent.
    """
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    across = normal[:, :, None] * normal[:, None, :]
    along = direction[:, :, None] * direction[:, None, :]
    covariance = np.zeros((len(direction), 4, 4))
    for end, block in ((0, slice(0, 2)), (1, slice(2, 4))):
        covariance[:, block, block] = (4 * variance_middle + common_px2 + off_px2[:, end])[
            :, None, None
        ] * across + np.square(sigma_along_px[:, end])[:, None, None] * along
    between = (common_px2 - 2 * variance_middle)[:, None, None] * across
    covariance[:, :2, 2:] = covariance[:, 2:, :2] = between
    return covariance
