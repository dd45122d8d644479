"""Pixels that show something else than the sheet: cut where they lie together, and counted."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.pixel_selection import SelectedPixels
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.numerics.tails import MAD_TO_SIGMA


def robust_sigma(residual: Float[np.ndarray, "n"], bound: float) -> float:
    """Standard deviation of grey levels by their median, over residuals below `bound`."""
    size = np.abs(residual)
    size = size[size < bound]
    return float(MAD_TO_SIGMA * np.median(size)) if len(size) else float("inf")


def gate_by_sigma(
    chosen: SelectedPixels,
    residual: Float[np.ndarray, "n"],
    sigma: Float[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """The pixels that stay where each has a noise of its own.

    Whole neighbourhoods go, whatever the signs of their pixels' residuals.
    """
    size = np.abs(residual) / sigma
    outlier, lone = size > tuning.outlier_sigmas, size > tuning.lone_sigmas
    return _apart_from_crowds(chosen, outlier, ~lone, tuning)


def without_common(
    chosen: SelectedPixels,
    standard: Float[np.ndarray, "n"],
    kept: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """The kept pixels, less neighbourhoods whose residuals, in sigmas, have a mean."""
    total, count = _sum_neighbourhoods(chosen, tuning.neighbourhood_px, standard * kept, kept)
    return kept & (total**2 <= tuning.largest_common * np.maximum(count, 1))


def _apart_from_crowds(
    chosen: SelectedPixels,
    wrong: Bool[np.ndarray, "n"],
    kept: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """`kept`, less whole neighbourhoods of wrong pixels."""
    if not wrong.any():
        return kept
    outliers, pixels = _sum_neighbourhoods(
        chosen, tuning.neighbourhood_px, wrong, np.ones(len(wrong))
    )
    return kept & (outliers <= tuning.outlier_share * pixels)


def _sum_neighbourhoods(
    chosen: SelectedPixels, side_px: int, *fields: Float[np.ndarray, "n"] | Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "fields n"]:
    """Sums of each field over the neighbourhood of each pixel."""
    left, top = chosen.column.min(), chosen.row.min()
    shape = (chosen.row.max() - top + 1, chosen.column.max() - left + 1)
    place = (chosen.row - top, chosen.column - left)
    sums = []
    for field in fields:
        picture = np.zeros(shape, np.float32)
        picture[place] = field
        blurred = cv2.boxFilter(
            picture, -1, (side_px, side_px), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        sums.append(blurred[place])
    return np.stack(sums)
