"""Corners of boards: grey levels as OpenCV's detectors take them, and the places and covariances
of corners between four squares."""

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
    room_px: Float[np.ndarray, "n"],
    tuning: CalibTuning,
) -> FittedCorners:
    """Corners as all that is around them shows them, from some px off.

    They are fitted from where gradients point past them (W. Forstner and E. Gulch, "A fast operator
    for detection and precise location of distinct points, corners and centres of circular
    features", 1987; `cv2.cornerSubPix`), which alone is three times less exact.

    grey : the picture by `levels_of_8_bit`. room_px : beside each corner to the next thing.
    """
    share, limits = tuning.detection.refined_share, tuning.detection.refined_half_px
    half_px = np.clip(share * room_px, *limits)
    half = int(np.median(half_px))
    places = cv2.cornerSubPix(
        grey,
        start_px.astype(np.float32).reshape(-1, 1, 2),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3),
    )
    fitted = fit_corners(image, places.reshape(-1, 2).astype(np.float64), half_px + 0.5, tuning)
    floor_px2 = tuning.detection.corner_floor_px**2 * np.eye(2)
    return fitted._replace(covariance_px2=fitted.covariance_px2 + floor_px2)


def distances_to_next(corners_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m"]:
    """From each corner to the nearest other one."""
    return np.asarray(point_tree(corners_px).query(corners_px, 2)[0])[:, 1]


def levels_of_8_bit(grey: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Grey levels between the darkest and the lightest as OpenCV's detectors take them."""
    low, high = float(grey.min()), float(grey.max())
    if low >= 0.0 and 127.0 < high <= 255.0:
        low, high = 0.0, 255.0
    levels = grey
    if (low, high) != (0.0, 255.0):
        levels = (grey - low) * (255.0 / max(high - low, 1e-9))
    # To the nearest level, and to 255 beyond: none is negative.
    return cv2.convertScaleAbs(levels)
