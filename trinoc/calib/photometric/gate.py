"""Exclusion of pixels that show something else than the sheet."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.pixel_selection import SelectedPixels
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.numerics.tails import MAD_TO_SIGMA


def robust_sigma(residual: Float[np.ndarray, "n"], bound: float) -> float:
    """Robust standard deviation of residuals by the median of those below `bound`, grey levels."""
    size = np.abs(residual)
    size = size[size < bound]
    return float(MAD_TO_SIGMA * np.median(size)) if len(size) else float("inf")


def gate_by_sigma(
    chosen: SelectedPixels,
    residual: Float[np.ndarray, "n"],
    sigma: Float[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Mask of the inliers, from residuals and noise.

    Single large residuals are excluded, and neighbourhoods with a large share of outliers.

    Parameters
    ----------
    chosen : the pixels.
    residual, sigma : (n,) residuals and their standard deviations.
    tuning : constants of the fit.
    """
    size = np.abs(residual) / sigma
    outlier, lone = size > tuning.outlier_sigmas, size > tuning.lone_sigmas
    return _remove_outlier_neighbourhoods(chosen, outlier, ~lone, tuning)


def remove_correlated_neighbourhoods(
    chosen: SelectedPixels,
    standard: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Remove neighbourhoods whose mean residual is significant.

    standard : (n,) residuals in standard deviations.
    """
    total, count = _sum_neighbourhoods(chosen, tuning.neighbourhood_px, standard * inliers, inliers)
    return inliers & (total**2 <= tuning.largest_common * np.maximum(count, 1))


def _remove_outlier_neighbourhoods(
    chosen: SelectedPixels,
    wrong: Bool[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Remove from `inliers` neighbourhoods with a large share of `wrong` pixels."""
    if not wrong.any():
        return inliers
    outliers, pixels = _sum_neighbourhoods(
        chosen, tuning.neighbourhood_px, wrong, np.ones(len(wrong))
    )
    return inliers & (outliers <= tuning.outlier_share * pixels)


def _sum_neighbourhoods(
    chosen: SelectedPixels, side_px: int, *fields: Float[np.ndarray, "n"] | Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "fields n"]:
    """Sum of each field over the square neighbourhood of each pixel."""
    first_column, first_row = chosen.column.min(), chosen.row.min()
    shape = (chosen.row.max() - first_row + 1, chosen.column.max() - first_column + 1)
    index = (chosen.row - first_row, chosen.column - first_column)
    sums = []
    for field in fields:
        image = np.zeros(shape, np.float32)
        image[index] = field
        filtered = cv2.boxFilter(
            image, -1, (side_px, side_px), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        sums.append(filtered[index])
    return np.stack(sums)
