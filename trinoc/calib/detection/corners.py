"""Corners of boards: grey levels as OpenCV's detectors take them, and how well a picture shows the
corner between four squares."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from trinoc.calib.detection.search_image import SearchImage
from trinoc.calib.tuning.every_group import TUNING
from trinoc.numerics.joins import point_tree


def refine_corners(
    grey: UInt8[np.ndarray, "h w"],
    start_px: Float[np.ndarray, "n 2"],
    room_px: Float[np.ndarray, "n"],
) -> Float[np.ndarray, "n 2"]:
    """Corners as all that is around them shows them: there, gradients point past them (W. Forstner
    and E. Gulch, "A fast operator for detection and precise location of distinct points, corners
    and centres of circular features", 1987; `cv2.cornerSubPix`).

    room_px : beside each corner to the next thing.
    """
    share, limits = TUNING.detection.refined_share, TUNING.detection.refined_half_px
    half = int(np.clip(share * np.median(room_px), *limits))
    places = cv2.cornerSubPix(
        grey,
        start_px.astype(np.float32).reshape(-1, 1, 2),
        (half, half),
        (-1, -1),
        (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3),
    )
    return places.reshape(-1, 2).astype(np.float64)


def corner_covariance_px2(
    image: SearchImage, corners_px: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2 2"]:
    """Covariance of each corner by the grey levels around it.

    Noise of variance s^2 leaves a corner the covariance s^2 (sum of g g^T)^-1, where g are the
    gradients in a window about it; that of the detector's own error comes on top. Only their
    ratios are to be trusted: a fit shows what corners really miss by.
    """
    grey = np.asarray(image.grey, dtype=np.float32)
    by_u = cv2.Scharr(grey, cv2.CV_32F, 1, 0, scale=1 / 32)
    by_v = cv2.Scharr(grey, cv2.CV_32F, 0, 1, scale=1 / 32)
    half = _half_window_px(corners_px)
    side = 2 * half + 1
    products = [
        cv2.boxFilter(product, cv2.CV_32F, (side, side), normalize=False)
        for product in (by_u * by_u, by_u * by_v, by_v * by_v)
    ]
    column, row = np.clip(
        np.rint(corners_px).astype(int), 0, np.array([grey.shape[1], grey.shape[0]]) - 1
    ).T
    a, b, c = (product[row, column].astype(np.float64) for product in products)
    # A window without structure must not make a matrix that has no inverse.
    floor = 1e-6 * (a + c).max() + 1e-12
    a, c = a + floor, c + floor
    determinant = np.maximum(a * c - b * b, floor**2)
    inverse = np.stack([np.stack([c, -b], axis=1), np.stack([-b, a], axis=1)], axis=1)
    noise = max(image.noise_sigma, 0.3)
    floor_px2 = TUNING.detection.corner_floor_px**2 * np.eye(2)
    return noise**2 * inverse / determinant[:, None, None] + floor_px2


def _half_window_px(corners_px: Float[np.ndarray, "m 2"]) -> int:
    pitch = float(np.median(distances_to_next(corners_px)))
    return int(np.clip(TUNING.detection.window_share * pitch, *TUNING.detection.half_window_px))


def distances_to_next(corners_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m"]:
    """From each corner to the nearest other one."""
    return np.asarray(point_tree(corners_px).query(corners_px, 2)[0])[:, 1]


def levels_of_8_bit(grey: Float[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Grey levels between the darkest and the lightest as OpenCV's detectors take them."""
    low, high = float(grey.min()), float(grey.max())
    if low >= 0.0 and 127.0 < high <= 255.0:
        low, high = 0.0, 255.0
    scale = 255.0 / max(high - low, 1e-9)
    return np.clip(np.rint((grey - low) * scale), 0, 255).astype(np.uint8)
