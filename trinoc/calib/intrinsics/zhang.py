"""A first lens and first poses by Zhang's method, as OpenCV has it.

OpenCV takes the centre of a circle's image for the image of its centre, which is a tenth of a
pixel wrong: good for a start and for nothing else. Source: Z. Zhang, "A flexible new technique
for camera calibration", PAMI 22(11), 2000.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection import Detection
from trinoc.calib.targets import AbstractTarget
from trinoc.errors import CalibrationError
from trinoc.geometry import AbstractLens, BrownConrady

FEWEST_CIRCLES = 4
# Focal lengths, in longer sides of the picture, to start from where Zhang's formula has none.
_FOCAL_SHARES = (0.7, 1.4, 3.0, 8.0)
# A circle further than this from its picture's homography, as a share of the sheet's extent,
# was located wrongly: lenses bend less.
_GROSS_ERROR = 0.05
_SMALLEST_GROSS_ERROR_PX = 3.0
_HELD = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)


class ZhangStart(NamedTuple):
    """Where the fit starts: a lens, and the pose of each picture (k, 3, 4)."""

    lens: AbstractLens
    cam_from_world: Float[np.ndarray, "k 3 4"]


def zhang_start(
    detections: Sequence[Detection],
    pattern: AbstractTarget,
    model: type[AbstractLens] = BrownConrady,
    aspect: float | None = None,
) -> ZhangStart:
    """Start of a fit; every detection must hold FEWEST_CIRCLES circles.

    model : of the lens. The coefficients of one that OpenCV does not start are zero.
    aspect : fx / fy where it is known.

    Several focal lengths are tried, as the formula has none where all pictures are taken
    square to the sheet. Raises CalibrationError where no start puts the circles near their
    places.
    """
    size = detections[0].image_size_px
    sheet, image = [], []
    for detection in detections:
        right = roughly_right(detection, pattern)
        points = pattern.centres_mm[detection.circle_index[right]]
        sheet.append(np.pad(points, ((0, 0), (0, 1))).astype(np.float32))
        image.append(detection.centres_px[right].astype(np.float32))
    starts = [_zhang(sheet, image, size, aspect)]
    starts += [_matrix(share * max(size), size, aspect) for share in _FOCAL_SHARES]
    fits = [_calibrated(sheet, image, size, start, aspect) for start in starts]
    misfit_px, first = min(fits, key=lambda fit: fit[0])
    if first is None or not np.isfinite(misfit_px):
        raise CalibrationError(
            "No lens explains where the circles lie: check that all pictures show this pattern "
            "and were taken by one camera at one zoom and focus."
        )
    if model is BrownConrady:
        return first
    lens, zeros = first.lens, np.zeros(len(model.coefficient_names))
    ideal = model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, zeros)
    return first._replace(lens=ideal)


def roughly_right(detection: Detection, pattern: AbstractTarget) -> Bool[np.ndarray, "m"]:
    """Circles that lie near the homography of most; all where there is no such homography."""
    sheet = pattern.centres_mm[detection.circle_index]
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    threshold = max(_SMALLEST_GROSS_ERROR_PX, _GROSS_ERROR * extent_px)
    try:
        _, mask = cv2.findHomography(sheet, detection.centres_px, cv2.RANSAC, threshold)
    except cv2.error:
        mask = None
    everything = np.ones(len(detection), dtype=bool)
    if mask is None:
        return everything
    right = np.asarray(mask).reshape(-1).astype(bool)
    return right if right.sum() >= FEWEST_CIRCLES else everything


def _zhang(
    sheet: list[np.ndarray],
    image: list[np.ndarray],
    size: tuple[int, int],
    aspect: float | None,
) -> np.ndarray | None:
    """Zhang's closed formula; None where the pictures do not determine a focal length."""
    try:
        matrix = cv2.initCameraMatrix2D(sheet, image, size, 0.0 if aspect is None else aspect)
    except cv2.error:
        return None
    focal = np.array([matrix[0, 0], matrix[1, 1]]) / max(size)
    plausible = np.isfinite(focal).all() and (focal > 0.1).all() and (focal < 100.0).all()
    return matrix if plausible else None


def _matrix(focal_px: float, size: tuple[int, int], aspect: float | None) -> np.ndarray:
    ratio = 1.0 if aspect is None else aspect
    return np.array(
        [[focal_px, 0, 0.5 * (size[0] - 1)], [0, focal_px / ratio, 0.5 * (size[1] - 1)], [0, 0, 1]]
    )


def _calibrated(
    sheet: list[np.ndarray],
    image: list[np.ndarray],
    size: tuple[int, int],
    start: np.ndarray | None,
    aspect: float | None,
) -> tuple[float, ZhangStart | None]:
    """Root mean square misfit in pixels, and the lens and poses that OpenCV reaches."""
    if start is None:
        return np.inf, None
    flags = _HELD if aspect is None else _HELD | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        misfit_px, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            sheet, image, size, start.copy(), np.zeros(5), flags=flags
        )
    except cv2.error:
        return np.inf, None
    poses = np.stack(
        [
            np.concatenate([cv2.Rodrigues(turn)[0], np.reshape(shift, (3, 1))], axis=1)
            for turn, shift in zip(turns, shifts, strict=True)
        ]
    )
    lens = BrownConrady(
        np.diag(matrix)[:2].copy(),
        matrix[:2, 2].copy(),
        np.zeros(()),
        distortion.reshape(-1)[: len(BrownConrady.coefficient_names)],
    )
    sound = np.isfinite(lens.parameters).all() and (lens.focal_length_px > 0).all()
    if not (sound and (poses[:, 2, 3] > 0).all()):
        return np.inf, None
    return float(misfit_px), ZhangStart(lens, poses)
