"""Covariance of segment ends: noise of the image, and disturbances that noise does not explain."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from trinoc.image.light import Light
from trinoc.image.strip import nearest_levels
from trinoc.segments.nevatia_babu.accept import BOW_OF_MIDDLE
from trinoc.segments.nevatia_babu.edge_points import EdgePoints, Runs
from trinoc.segments.nevatia_babu.line_fit import FittedLines
from trinoc.segments.nevatia_babu.neighbours import Overlaps
from trinoc.segments.nevatia_babu.side_slopes import Shifts
from trinoc.segments.tuning import DEFAULT, ErrorTuning

_PIXEL_VARIANCE = 1 / 12  # numerical: of a box of one pixel


class ErrorModel(NamedTuple):
    """Disturbances of each line besides noise.

    Attributes
    ----------
    pull_px : (r,)
        Mean displacement of the points that was corrected for neighbouring lines.
    crowded : (r,)
        Share of the points with another line nearby.
    saturated : (r,)
        Share of the points with a saturated bright side.
    sagitta_px : (r,)
        Bow of the line; 0 if noise explains it.
    scatter_px : (r,)
        Root mean square distance of the points from the line, without the part due to noise.
    off_px : (r, 2)
        Mean distance of the last points at each end from the line; 0 if noise explains the
        distance. A neighbouring edge near this end causes a larger value.
    """

    pull_px: Float[np.ndarray, "r"]
    crowded: Float[np.ndarray, "r"]
    saturated: Float[np.ndarray, "r"]
    sagitta_px: Float[np.ndarray, "r"]
    scatter_px: Float[np.ndarray, "r"]
    off_px: Float[np.ndarray, "r 2"]


def error_model(
    picture: Light,
    measured: EdgePoints,
    cleaned: Runs,
    lines: FittedLines,
    overlaps: Overlaps,
    usual_blur_px2: float,
    tuning: ErrorTuning = DEFAULT.errors,
) -> ErrorModel:
    """Measure the disturbances of each line, from its points before and after their correction.

    Parameters
    ----------
    picture : Light
        Image at full resolution.
    measured : EdgePoints
        Points before the correction for neighbouring lines.
    cleaned : Runs
        Runs of the corrected points.
    lines : FittedLines
        Lines fitted to the corrected points.
    overlaps : Overlaps
        Points near other lines.
    usual_blur_px2 : float
        Typical blur variance of edges.
    tuning : ErrorTuning
        Thresholds.
    """
    bow = np.abs(lines.sagitta_px)
    noise_bow = BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2)
    noise_px = tuning.noise_sigmas * np.sqrt(lines.variance_middle_px2 * lines.support)
    shift = (cleaned.points.uv_px - measured.uv_px).astype(np.float64)
    has_neighbour = np.zeros(len(measured.strength))
    has_neighbour[overlaps.point] = 1.0
    # Saturation makes an edge appear sharper.
    blur = np.sqrt(np.maximum(lines.blur_px2, usual_blur_px2) + _PIXEL_VARIANCE)
    distance_px = cleaned.spread(tuning.bright_side_widths * blur).astype(np.float32)
    bright = measured.sample_px + distance_px[:, None] * measured.normal
    level = nearest_levels(picture.levels, *bright.T)
    return ErrorModel(
        cleaned.mean(np.hypot(shift[:, 0], shift[:, 1])),
        cleaned.mean(has_neighbour),
        cleaned.mean((level >= picture.white).astype(np.float64)),
        np.where(bow > tuning.noise_sigmas * noise_bow, bow, 0.0),
        np.sqrt(np.maximum(lines.residual_px**2 - noise_px**2, 0.0)),
        _end_deviations(cleaned, lines, noise_px, tuning.last_points),
    )


def _end_deviations(
    runs: Runs, lines: FittedLines, least_px: Float[np.ndarray, "r"], last_points: int
) -> Float[np.ndarray, "r 2"]:
    """Return the mean distance of the last points at either end from their line, (r, 2) px.

    Distances below `least_px` / sqrt(number of points) are set to 0, because noise explains them.
    """
    first, count = runs.first[:, None], np.minimum(last_points, runs.count)[:, None]
    steps = np.arange(last_points)
    ends = np.stack([first + steps, first + runs.count[:, None] - 1 - steps], axis=1)
    within = (steps < count)[:, None]
    offset = runs.points.uv_px[np.where(within, ends, first[:, None])]
    offset = offset - lines.centre_px[:, None, None]
    direction = lines.direction[:, None, None]
    across = offset[..., 1] * direction[..., 0] - offset[..., 0] * direction[..., 1]
    mean = np.abs((across * within).sum(axis=2)) / count
    return np.where(mean > least_px[:, None] / np.sqrt(count), mean, 0.0)


def inflate_variance(
    disturbed: ErrorModel,
    noise_px2: Float[np.ndarray, "r"],
    saturated: Shifts,
    shaded: Shifts,
    tuning: ErrorTuning = DEFAULT.errors,
) -> tuple[Float[np.ndarray, "r"], Float[np.ndarray, "r"], Shaped[np.ndarray, "r"]]:
    """Add the variances of all disturbances to the variance by noise.

    Saturation, shading and a neighbour along the whole line displace a line as a whole.

    Parameters
    ----------
    disturbed : ErrorModel
        Disturbances of each line.
    noise_px2 : (r,)
        Variance of the line's midpoint by noise alone.
    saturated, shaded : Shifts
        Corrections for saturation and shading.
    tuning : ErrorTuning
        Tuned constants.

    Returns
    -------
    tuple
        Variance of the midpoint from errors that also turn the line (r,). Variance of the
        displacement as a whole (r,). Name of the largest disturbance that exceeds noise (r,):
        "neighbour", "bent", "saturated", "shaded" or "".
    """
    crowd_px = tuning.crowd_px * np.square(disturbed.crowded)
    neighbour = np.square(disturbed.pull_px) + np.square(crowd_px)
    bent = np.square(tuning.bow_share * disturbed.sagitta_px)
    bent += np.square(tuning.scatter_share * disturbed.scatter_px)
    parts = np.stack([neighbour, bent, saturated.variance_px2, shaded.variance_px2])
    names = np.array(["neighbour", "bent", "saturated", "shaded"])
    reasons = np.where(parts.max(axis=0) > noise_px2, names[parts.argmax(axis=0)], "")
    # A neighbour along the whole line shifts it more than it turns it.
    along_line = disturbed.crowded * neighbour
    turning = neighbour - (1 - tuning.turn_share) * along_line
    common = along_line + saturated.variance_px2 + shaded.variance_px2
    return noise_px2 + bent + turning, common, reasons


def noise_variance(
    variance_middle_px2: Float[np.ndarray, "r"],
    length_px: Float[np.ndarray, "r"],
    tuning: ErrorTuning = DEFAULT.errors,
) -> Float[np.ndarray, "r"]:
    """Return the variance of each line's midpoint across the line, by noise and model error, (r,)
    px^2.

    `variance_middle_px2` is the variance by image noise alone.
    """
    independent = tuning.model_sigma_per_pixel**2 / np.maximum(length_px, 1.0)
    model = tuning.model_sigma_px**2 + independent
    return tuning.noise_excess * variance_middle_px2 + model


def end_covariances(
    direction: Float[np.ndarray, "r 2"],
    variance_middle: Float[np.ndarray, "r"],
    common_px2: Float[np.ndarray, "r"],
    off_px2: Float[np.ndarray, "r 2"],
    sigma_along_px: Float[np.ndarray, "r 2"],
) -> Float[np.ndarray, "r 4 4"]:
    """Return the covariance of the ends (u1, v1, u2, v2) of each line, (r, 4, 4).

    Parameters
    ----------
    direction : (r, 2)
        Unit vector along the line.
    variance_middle : (r,)
        Variance of the midpoint across the line, from errors that also turn the line.
    common_px2 : (r,)
        Variance of a displacement of the line as a whole.
    off_px2 : (r, 2)
        Additional variance of each end.
    sigma_along_px : (r, 2)
        Standard deviation of each end along the line. The two ends are independent in this
        direction.

    Notes
    -----
    For points spread evenly over the length L, the angle of a line has 12 / L^2 times the variance
    of its midpoint. Each end then has four times that variance, and the ends have a correlation of
    -1/2.
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
