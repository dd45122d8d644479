"""Exclusion of pixels that show something else than the sheet."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.photometric.pixel_selection import SelectedPixels
from trinoc.calib.tuning.photometric import PhotometricTuning
from trinoc.numerics.tails import MAD_TO_SIGMA


def robust_sigma(residual: Float[np.ndarray, "n"], bound: float) -> float:
    """Standard deviation of residuals, estimated by the median of their absolute values.

    Residuals of `bound` grey levels or more are ignored. Infinity if none is smaller.
    """
    size = np.abs(residual)
    size = size[size < bound]
    return float(MAD_TO_SIGMA * np.median(size)) if len(size) else float("inf")


def gate_by_sigma(
    pixels: SelectedPixels,
    residual: Float[np.ndarray, "n"],
    sigma: Float[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Mask of the inlier pixels, from their residuals and their noise.

    A pixel is excluded if its residual is very large, or if a large share of the pixels around it
    are outliers.

    Parameters
    ----------
    pixels : the pixels.
    residual, sigma : (n,) residuals and their standard deviations.
    tuning : constants of the fit.
    """
    size = np.abs(residual) / sigma
    outlier, lone = size > tuning.outlier_sigmas, size > tuning.lone_sigmas
    return _remove_outlier_neighbourhoods(pixels, outlier, ~lone, tuning)


def remove_correlated_neighbourhoods(
    pixels: SelectedPixels,
    standard: Float[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Remove inliers whose square neighbourhood has a significant mean residual.

    Parameters
    ----------
    pixels : the pixels.
    standard : (n,) residuals divided by their standard deviations.
    inliers : (n,) mask of the inliers.
    tuning : constants of the fit.

    Returns
    -------
    (n,) mask of the remaining inliers.
    """
    total, count = _sum_neighbourhoods(pixels, tuning.neighbourhood_px, standard * inliers, inliers)
    return inliers & (total**2 <= tuning.largest_common * np.maximum(count, 1))


def _remove_outlier_neighbourhoods(
    pixels: SelectedPixels,
    outlier: Bool[np.ndarray, "n"],
    inliers: Bool[np.ndarray, "n"],
    tuning: PhotometricTuning,
) -> Bool[np.ndarray, "n"]:
    """Remove the inliers whose square neighbourhood contains a large share of outliers.

    outlier : (n,) mask of the outliers.

    Returns
    -------
    (n,) mask of the remaining inliers.
    """
    if not outlier.any():
        return inliers
    outliers, pixel_count = _sum_neighbourhoods(
        pixels, tuning.neighbourhood_px, outlier, np.ones(len(outlier))
    )
    return inliers & (outliers <= tuning.outlier_share * pixel_count)


def _sum_neighbourhoods(
    pixels: SelectedPixels, side_px: int, *fields: Float[np.ndarray, "n"] | Bool[np.ndarray, "n"]
) -> Float[np.ndarray, "fields n"]:
    """Sum of each field over the square neighbourhood of each pixel, (fields, n).

    side_px : side of the square.
    """
    first_column, first_row = pixels.column.min(), pixels.row.min()
    shape = (pixels.row.max() - first_row + 1, pixels.column.max() - first_column + 1)
    index = (pixels.row - first_row, pixels.column - first_column)
    sums = []
    for field in fields:
        image = np.zeros(shape, np.float32)
        image[index] = field
        filtered = cv2.boxFilter(
            image, -1, (side_px, side_px), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        sums.append(filtered[index])
    return np.stack(sums)
