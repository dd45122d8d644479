"""Steps shared by the detectors of chessboards and markers: 8-bit levels, refined corners."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from trinoc.calib.detection.corner_fit import FittedCorners, fit_corners
from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.tuning.every_group import CalibTuning
from trinoc.numerics.joins import point_tree


def refine_corners(
    image: SearchImage,
    grey: UInt8[np.ndarray, "h w"],
    start_px: Float[np.ndarray, "n 2"],
    clearance_px: Float[np.ndarray, "n"],
    tuning: CalibTuning,
) -> FittedCorners:
    """Refine corner positions that are accurate to some pixels.

    The first step is `cv2.cornerSubPix`. It draws a line through each pixel, perpendicular to the
    grey-level gradient, and finds the point nearest to all lines. The second step fits the grey
    levels (`fit_corners`), which is three times as accurate.

    Parameters
    ----------
    image : grey image with its noise.
    grey : the same image with 8-bit levels, from `levels_of_8_bit`.
    start_px : (n, 2) approximate positions.
    clearance_px : (n,) distance from each corner to the nearest other edge or corner.
    tuning : tuned constants of calibration.

    References
    ----------
    W. Forstner and E. Gulch, "A fast operator for detection and precise location of distinct
    points, corners and centres of circular features", 1987.
    """
    share, limits = tuning.detection.refined_share, tuning.detection.refined_half_px
    half_px = np.clip(share * clearance_px, *limits)
    half = int(np.median(half_px))
    corners_px = cv2.cornerSubPix(
        grey,
        start_px.astype(np.float32).reshape(-1, 1, 2),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3),
    )
    fitted = fit_corners(image, corners_px.reshape(-1, 2).astype(np.float64), half_px + 0.5, tuning)
    floor_px2 = tuning.detection.corner_floor_px**2 * np.eye(2)
    return fitted._replace(covariance_px2=fitted.covariance_px2 + floor_px2)


def distances_to_next(corners_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m"]:
    """Distance from each corner to the nearest other corner, px."""
    return np.asarray(point_tree(corners_px).query(corners_px, 2)[0])[:, 1]


def levels_of_8_bit(grey: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Convert grey levels to 8 bit for OpenCV.

    Levels that do not have the range of an 8-bit image are stretched to 0 to 255.
    """
    low, high = float(grey.min()), float(grey.max())
    if low >= 0.0 and 127.0 < high <= 255.0:
        low, high = 0.0, 255.0
    levels = grey
    if (low, high) != (0.0, 255.0):
        levels = (grey - low) * (255.0 / max(high - low, 1e-9))
    # Rounds to the nearest level and clips at 255; no level is negative.
    return cv2.convertScaleAbs(levels)
