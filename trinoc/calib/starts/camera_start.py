"""Initial lens of one camera, and the pose of the board in each of its images.

Lens models that contain an ideal lens start with Zhang's method, fisheye models with a search over
focal lengths. OpenCV's implementation takes the centre of a circle's image for the image of its
centre. This error of about 0.1 px is acceptable for initial values. Source: Z. Zhang, "A flexible
new technique for camera calibration", PAMI 22(11), 2000.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float

from trinoc.calib.detection.detection import Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import CalibrationError
from trinoc.geometry.lenses.abstract_lens import AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.lenses.registry import promote_lens
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points, unproject_pixels

# numerical: points that determine a homography.
FEWEST_POINTS = 4
_FIXED_FLAGS = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)


class CameraStart(NamedTuple):
    """Initial values for the fit of one camera.

    Attributes
    ----------
    lens : initial lens.
    cam_from_board : initial board pose in each of k images.
    """

    lens: AbstractLens
    cam_from_board: tuple[Pose, ...]


def start_camera(
    detections: Sequence[Detection],
    target: AbstractTarget,
    model: type[AbstractLens],
    *,
    lens: AbstractLens | None = None,
    aspect: float | None = None,
    tuning: CalibTuning = TUNING,
) -> CameraStart:
    """Estimate an initial lens, and the pose of the board in each image.

    The principal point is the middle of the image.

    Parameters
    ----------
    detections : detections in the images of one camera, each with at least FEWEST_POINTS points.
    target : the board.
    model : lens model.
    lens : given lens; then only the poses are estimated.
    aspect : fx / fy if it is known.
    tuning : constants of the method.

    Raises
    ------
    CalibrationError : no lens of this model explains the detections.
    """
    if lens is not None:
        return start_poses(promote_lens(lens), detections, target)
    if model.zero_is_ideal:
        return _start_by_zhang(detections, target, model, aspect, tuning)
    width, height = detections[0].image_size_px
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    focal_px = max(width, height) * np.array([1.0, 1.0 / (aspect or 1.0)])
    zero_coefficients = np.zeros(len(model.coefficient_names))
    starts = [
        start_poses(
            model(share * focal_px, middle, np.zeros(()), zero_coefficients), detections, target
        )
        for share in tuning.starts.fisheye_shares
    ]

    def reprojection_error(start: CameraStart) -> float:
        pairs = zip(start.cam_from_board, detections, strict=True)
        errors_px = [
            median_error_px(start.lens, pose, detection, target) for pose, detection in pairs
        ]
        return float(np.median(errors_px))

    return min(starts, key=reprojection_error)


def start_poses(
    lens: AbstractLens, detections: Sequence[Detection], target: AbstractTarget
) -> CameraStart:
    """Estimate the pose of the board in each image for a given lens.

    Raises `CalibrationError` if the points of an image do not determine the pose.
    """
    poses = []
    for detection in detections:
        rays = unproject_pixels(lens, detection.centres_px)
        pose = plane_pose(rays, target.centres_mm[detection.circle_index])
        if pose is None:
            raise CalibrationError(
                "The points found in an image do not determine the pose of the board: show more of "
                "it."
            )
        poses.append(pose)
    return CameraStart(lens, tuple(poses))


def median_error_px(
    lens: AbstractLens, cam_from_board: Pose, detection: Detection, target: AbstractTarget
) -> float:
    """Median distance between predicted and detected board points, px.

    A point behind the camera has an infinite distance.
    """
    points_mm = target.centres_mm[detection.circle_index]
    offset = project_points(cam_from_board, lens, on_board(points_mm)) - detection.centres_px
    distance = np.linalg.norm(offset, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def on_board(points_mm: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
    """Append Z = 0 to points of the drawing. Returns (m, 3)."""
    return np.pad(points_mm, ((0, 0), (0, 1)))


def plane_pose(rays: Float[np.ndarray, "m 3"], points_mm: Float[np.ndarray, "m 2"]) -> Pose | None:
    """Estimate cam_from_board from the homography between the board and the camera rays.

    Each ray is parallel to H (X, Y, 1), which gives two equations. Rays may have any length and may
    point backwards, as in a fisheye lens. Returns None if the points do not determine a homography.

    rays : (m, 3) rays to the points in the frame of the camera.
    points_mm : (m, 2) the points on the board.

    References
    ----------
    Hartley and Zisserman, Multiple View Geometry, section 4.1.
    """
    middle, spread = points_mm.mean(axis=0), float(np.std(points_mm)) or 1.0
    homogeneous = np.append((points_mm - middle) / spread, np.ones((len(points_mm), 1)), axis=1)
    # Two directions orthogonal to each ray.
    _, _, axes = np.linalg.svd(rays[:, None, :])
    rows = (axes[:, 1:, :, None] * homogeneous[:, None, None, :]).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows)
    if not (np.isfinite(values).all() and values[7] > 1e-9 * values[0]):
        return None
    homography = vectors[-1].reshape(3, 3)
    if np.sum(rays * (homogeneous @ homography.T)) < 0:
        homography = -homography
    first, second, origin = homography.T
    length = np.sqrt(np.linalg.norm(first) * np.linalg.norm(second))
    rotation = nearest_rotation(np.stack([first, second, np.cross(first, second) / length], axis=1))
    translation = origin * spread / length - rotation[:, :2] @ middle
    return Pose(np.column_stack([rotation, translation]))


def nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """Rotation nearest to a matrix in the least-squares sense."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _start_by_zhang(
    detections: Sequence[Detection],
    target: AbstractTarget,
    model: type[AbstractLens],
    aspect: float | None,
    tuning: CalibTuning,
) -> CameraStart:
    """Initial lens and poses by Zhang's method (OpenCV), from several initial focal lengths.

    The start with the smallest residuals is returned. Zhang's closed formula has no solution if the
    board is parallel to the image plane in all images. Coefficients of models that OpenCV does not
    support are 0.

    model : lens model. aspect : fx / fy, or None to estimate both focal lengths.
    """
    size = detections[0].image_size_px
    sheet, image = [], []
    for detection in detections:
        is_consistent = _near_homography(detection, target, tuning)
        points_mm = target.centres_mm[detection.circle_index[is_consistent]]
        sheet.append(on_board(points_mm).astype(np.float32))
        image.append(detection.centres_px[is_consistent].astype(np.float32))
    guesses = [_zhang_matrix(sheet, image, size, aspect)]
    middle = 0.5 * (np.array(size) - 1.0)
    for share in tuning.starts.focal_shares:
        focal_px = share * max(size) * np.array([1.0, 1.0 / (aspect or 1.0)])
        guesses.append(
            np.array([[focal_px[0], 0, middle[0]], [0, focal_px[1], middle[1]], [0, 0, 1]])
        )
    valid = [guess for guess in guesses if guess is not None]
    fits = [_fit_by_opencv(sheet, image, size, guess, aspect) for guess in valid]
    fits = [fit for fit in fits if fit is not None]
    if not fits:
        raise CalibrationError(
            "No lens explains the detected circles: check that all images show this pattern and "
            "were taken by one camera at one zoom and focus."
        )
    _, start = min(fits, key=lambda fit: fit[0])
    if model is BrownConrady:
        return start
    lens, zeros = start.lens, np.zeros(len(model.coefficient_names))
    ideal = model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, zeros)
    return start._replace(lens=ideal)


def _near_homography(
    detection: Detection, target: AbstractTarget, tuning: CalibTuning
) -> Bool[np.ndarray, "m"]:
    """Mask, (m,), of the points that agree with one homography, fitted by RANSAC.

    All True if it cannot be fitted.
    """
    sheet = target.centres_mm[detection.circle_index]
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    threshold = max(tuning.starts.least_px, tuning.starts.gross_share * extent_px)
    is_near = np.ones(len(detection), dtype=bool)
    try:
        _, mask = cv2.findHomography(sheet, detection.centres_px, cv2.RANSAC, threshold)
    except cv2.error:
        return is_near
    if mask is not None and np.count_nonzero(mask) >= FEWEST_POINTS:
        is_near = np.asarray(mask).reshape(-1).astype(bool)
    return is_near


def _zhang_matrix(
    sheet: list[np.ndarray], image: list[np.ndarray], size: tuple[int, int], aspect: float | None
) -> Float[np.ndarray, "3 3"] | None:
    """Camera matrix by Zhang's closed formula; None if the images determine no plausible focal
    length.

    sheet, image : board points and their pixels in each image.
    size : (width, height) of the images.
    """
    try:
        matrix = cv2.initCameraMatrix2D(sheet, image, size, 0.0 if aspect is None else aspect)
    except cv2.error:
        return None
    focal = np.array([matrix[0, 0], matrix[1, 1]]) / max(size)
    plausible = np.isfinite(focal).all() and (focal > 0.1).all() and (focal < 100.0).all()
    return matrix if plausible else None


def _fit_by_opencv(
    sheet: list[np.ndarray],
    image: list[np.ndarray],
    size: tuple[int, int],
    guess: Float[np.ndarray, "3 3"],
    aspect: float | None,
) -> tuple[float, CameraStart] | None:
    """Fit a Brown-Conrady lens and the board poses with OpenCV.

    Returns the root mean square residual, px, and the fit; None if the result is not valid.

    sheet, image : board points and their pixels in each image.
    size : (width, height) of the images.
    guess : initial camera matrix.
    aspect : fx / fy if it is fixed at that of `guess`; None to estimate both focal lengths.
    """
    flags = _FIXED_FLAGS if aspect is None else _FIXED_FLAGS | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        misfit_px, matrix, distortion, rotations, translations = cv2.calibrateCamera(
            sheet, image, size, guess.copy(), np.zeros(5), flags=flags
        )
    except cv2.error:
        return None
    poses = tuple(
        Pose(np.column_stack([cv2.Rodrigues(rotation)[0], np.ravel(translation)]))
        for rotation, translation in zip(rotations, translations, strict=True)
    )
    lens = BrownConrady(
        np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), np.zeros(()), distortion.ravel()[:5]
    )
    is_valid = np.isfinite([misfit_px, *lens.parameters]).all() and (lens.focal_length_px > 0).all()
    in_front = all(pose.translation_mm[2] > 0 for pose in poses)
    return (float(misfit_px), CameraStart(lens, poses)) if is_valid and in_front else None
