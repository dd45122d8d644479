"""What disturbs the place of a segment beyond the noise of the picture."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from trinoc.numerics import sums
from trinoc.segments.nevatia_babu.accept import BOW_OF_MIDDLE
from trinoc.segments.nevatia_babu.edge_interference import Overlaps
from trinoc.segments.nevatia_babu.edge_points import EdgePoints
from trinoc.segments.nevatia_babu.line_fit import FittedLines

# What each disturbance moves a line by: chosen so that the errors of the segments it widens have
# about the variance that is claimed, on rendered block scenes without shadows (other ones than
# those that benchmarks/segments.py reports on).
_PULL_SHARE = 0.8
_CROWD_PX, _CROWD_FROM = 0.4, 0.4
_WIDE_SHARE, _WIDE_FROM_PX = 0.2, 0.5
# A step that goes on above white by as much again as is seen of it moves by 0.7 widths of its
# blur toward dark, twice that much above white by 1.1, half as much by 0.4.
_SATURATED_WIDTHS, _SATURATED_PX, _SATURATED_FROM = 0.5, 0.25, 0.3
_BOW_SHARE, _BOW_SIGMAS = 0.2, 1.5

# How far toward the brighter side a pixel must be saturated to bend the profile: at least so many
# pixels, and so many widths of the blur.
_BRIGHT_SIDE_PX, _BRIGHT_SIDE_WIDTHS = 2.0, 1.75
_PIXEL_VARIANCE = 1 / 12


class ErrorModel(NamedTuple):
    """Of each line, what besides noise may have moved it.

    Fields
    ------
    pull_px : (r,) mean shift of the points that was ascribed to neighbours.
    crowded : (r,) share of the points that have a neighbouring line within reach.
    widening_px : (r,) root of the variance by which the profile is wider than the typical one.
    saturated : (r,) share of the points whose bright side is saturated.
    blur_px : (r,) width of the blur, at least the typical one of the image.
    sagitta_px : (r,) deviation from straightness that noise does not explain.
    """

    pull_px: Float[np.ndarray, "r"]
    crowded: Float[np.ndarray, "r"]
    widening_px: Float[np.ndarray, "r"]
    saturated: Float[np.ndarray, "r"]
    blur_px: Float[np.ndarray, "r"]
    sagitta_px: Float[np.ndarray, "r"]

    def select(self, which: Bool[np.ndarray, "r"]) -> "Disturbances":
        """Those of the lines where the mask is true."""
        return ErrorModel(*(field[which] for field in self))


def error_model(
    grey: Float[np.ndarray, "h w"],
    white: float,
    measured: EdgePoints,
    cleaned: EdgePoints,
    first: Int[np.ndarray, "r"],
    lines: FittedLines,
    found: Overlaps,
    usual_blur_px2: float,
) -> ErrorModel:
    """Compare the points as measured and after neighbours were taken out.

    `lines` are fitted to the cleaned points, which lie line after line from first[k] on.
    """
    bow = np.abs(lines.sagitta_px)
    count = lines.support.astype(np.float64)
    shift = (cleaned.uv_px - measured.uv_px).astype(np.float64)
    near = np.zeros(len(measured.strength))
    near[found.point] = 1.0
    # A saturated edge looks sharper than it is.
    blur = np.sqrt(np.maximum(lines.blur_px2, usual_blur_px2) + _PIXEL_VARIANCE)
    beside = np.maximum(
        _BRIGHT_SIDE_PX * measured.spacing_px,
        np.repeat(_BRIGHT_SIDE_WIDTHS * blur, lines.support).astype(np.float32),
    )
    bright = measured.sample_px + beside[:, None] * measured.normal
    column, row = np.rint(bright).astype(np.int64).T
    height, width = grey.shape
    level = grey[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return ErrorModel(
        sums(np.linalg.norm(shift, axis=-1), first) / count,
        sums(near, first) / count,
        np.sqrt(np.maximum(lines.blur_px2 - usual_blur_px2, 0.0)),
        sums((level >= white).astype(np.float64), first) / count,
        blur,
        np.where(bow > _BOW_SIGMAS * BOW_OF_MIDDLE * np.sqrt(lines.variance_middle_px2), bow, 0.0),
    )


def inflate_variance(
    disturbed: ErrorModel, noise_px2: Float[np.ndarray, "r"]
) -> tuple[Float[np.ndarray, "r"], Shaped[np.ndarray, "r"]]:
    """(variance, reason): of each line's place across it, and what added most to it.

    `noise_px2` is the variance from noise alone. The reason is "neighbour", "wide",
    "saturated" or "bent" where that adds more than noise does, and "" elsewhere.
    """
    parts = {
        "neighbour": np.hypot(
            _PULL_SHARE * disturbed.pull_px,
            _CROWD_PX * np.clip(disturbed.crowded - _CROWD_FROM, 0.0, None),
        ),
        "wide": _WIDE_SHARE * np.clip(disturbed.widening_px - _WIDE_FROM_PX, 0.0, None),
        "saturated": np.hypot(_SATURATED_PX, _SATURATED_WIDTHS * disturbed.blur_px)
        * (disturbed.saturated > _SATURATED_FROM),
        "bent": _BOW_SHARE * disturbed.sagitta_px,
    }
    squares = np.square(np.stack(list(parts.values())))
    most = squares.argmax(axis=0)
    reasons = np.where(squares.max(axis=0) > noise_px2, np.array(list(parts))[most], "")
    return noise_px2 + squares.sum(axis=0), reasons
