"""A first lens of one camera, and the pose of the board in each of its pictures.

A lens that may be ideal starts by Zhang's method, a fisheye by trying focal lengths. OpenCV, which
has the former, takes the centre of a circle's image for the image of its centre, which is a tenth
of a pixel wrong: good for a start and for nothing else. Source: Z. Zhang, "A flexible new technique
for camera calibration", PAMI 22(11), 2000.
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

# numerical: those of a homography.
FEWEST_PLACES = 4
_HELD = (
    cv2.CALIB_USE_INTRINSIC_GUESS
    | cv2.CALIB_FIX_PRINCIPAL_POINT
    | cv2.CALIB_ZERO_TANGENT_DIST
    | cv2.CALIB_FIX_K2
    | cv2.CALIB_FIX_K3
)


class CameraStart(NamedTuple):
    """Where the fit of one camera starts: a lens, and the board in each of k pictures."""

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
    """A lens of the model in the middle of the picture, and poses; poses alone for a given `lens`.

    Every detection must hold FEWEST_PLACES. aspect : fx / fy where it is known.

    Raises CalibrationError where no lens of the model puts the places near where they are seen.
    """
    if lens is not None:
        return start_poses(promote_lens(lens), detections, target)
    if model.zero_is_ideal:
        return _start_by_zhang(detections, target, model, aspect, tuning)
    width, height = detections[0].image_size_px
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    focal_px = max(width, height) * np.array([1.0, 1.0 / (aspect or 1.0)])
    none = np.zeros(len(model.coefficient_names))
    starts = [
        start_poses(model(share * focal_px, middle, np.zeros(()), none), detections, target)
        for share in tuning.starts.fisheye_shares
    ]

    def reprojection_error(start: CameraStart) -> float:
        pairs = zip(start.cam_from_board, detections, strict=True)
        return float(np.median([miss_px(start.lens, pose, seen, target) for pose, seen in pairs]))

    return min(starts, key=reprojection_error)


def start_poses(
    lens: AbstractLens, detections: Sequence[Detection], target: AbstractTarget
) -> CameraStart:
    """The pose of the board in each picture through a known lens."""
    poses = []
    for detection in detections:
        rays = unproject_pixels(lens, detection.centres_px)
        pose = plane_pose(rays, target.centres_mm[detection.circle_index])
        if pose is None:
            raise CalibrationError(
                "The places found in a picture do not tell where the board stands: show more of it."
            )
        poses.append(pose)
    return CameraStart(lens, tuple(poses))


def miss_px(
    lens: AbstractLens, cam_from_board: Pose, detection: Detection, target: AbstractTarget
) -> float:
    """Median distance of what is seen from where it should be; infinite behind the camera."""
    places_mm = target.centres_mm[detection.circle_index]
    off = project_points(cam_from_board, lens, on_board(places_mm)) - detection.centres_px
    distance = np.linalg.norm(off, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def on_board(places_mm: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
    """Places of a drawing on the plane Z = 0 of its board."""
    return np.pad(places_mm, ((0, 0), (0, 1)))


def plane_pose(rays: Float[np.ndarray, "m 3"], places_mm: Float[np.ndarray, "m 2"]) -> Pose | None:
    """cam_from_board of the homography from the board to the rays; None where there is none.

    Rays are of any length and may look backwards, as those of a fisheye do: each is parallel to H
    (X, Y, 1), which is two equations. Source: Hartley and Zisserman, section 4.1.
    """
    middle, spread = places_mm.mean(axis=0), float(np.std(places_mm)) or 1.0
    place = np.append((places_mm - middle) / spread, np.ones((len(places_mm), 1)), axis=1)
    # The two directions across each ray.
    _, _, axes = np.linalg.svd(rays[:, None, :])
    rows = (axes[:, 1:, :, None] * place[:, None, None, :]).reshape(-1, 9)
    _, values, vectors = np.linalg.svd(rows)
    if not (np.isfinite(values).all() and values[7] > 1e-9 * values[0]):
        return None
    homography = vectors[-1].reshape(3, 3)
    if np.sum(rays * (place @ homography.T)) < 0:
        homography = -homography
    first, second, origin = homography.T
    length = np.sqrt(np.linalg.norm(first) * np.linalg.norm(second))
    rotation = nearest_rotation(np.stack([first, second, np.cross(first, second) / length], axis=1))
    translation = origin * spread / length - rotation[:, :2] @ middle
    return Pose(np.column_stack([rotation, translation]))


def nearest_rotation(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation next to a matrix in the sense of least squares."""
    u, _, v = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _start_by_zhang(
    detections: Sequence[Detection],
    target: AbstractTarget,
    model: type[AbstractLens],
    aspect: float | None,
    tuning: CalibTuning,
) -> CameraStart:
    """Several focal lengths are tried, as the formula has none where all pictures are taken square
    to the board. Coefficients of a model that OpenCV does not start are zero."""
    size = detections[0].image_size_px
    sheet, image = [], []
    for detection in detections:
        right = _roughly_right(detection, target, tuning)
        places_mm = target.centres_mm[detection.circle_index[right]]
        sheet.append(on_board(places_mm).astype(np.float32))
        image.append(detection.centres_px[right].astype(np.float32))
    guesses = [_zhang_matrix(sheet, image, size, aspect)]
    middle = 0.5 * (np.array(size) - 1.0)
    for share in tuning.starts.focal_shares:
        focal_px = share * max(size) * np.array([1.0, 1.0 / (aspect or 1.0)])
        guesses.append(
            np.array([[focal_px[0], 0, middle[0]], [0, focal_px[1], middle[1]], [0, 0, 1]])
        )
    known = [guess for guess in guesses if guess is not None]
    fits = [_fit_by_opencv(sheet, image, size, guess, aspect) for guess in known]
    fits = [fit for fit in fits if fit is not None]
    if not fits:
        raise CalibrationError(
            "No lens explains where the circles lie: check that all pictures show this pattern "
            "and were taken by one camera at one zoom and focus."
        )
    _, start = min(fits, key=lambda fit: fit[0])
    if model is BrownConrady:
        return start
    lens, zeros = start.lens, np.zeros(len(model.coefficient_names))
    ideal = model(lens.focal_length_px, lens.principal_point_px, lens.skew_px, zeros)
    return start._replace(lens=ideal)


def _roughly_right(
    detection: Detection, target: AbstractTarget, tuning: CalibTuning
) -> Bool[np.ndarray, "m"]:
    """Places that lie near the homography of most; all where there is no such homography."""
    sheet = target.centres_mm[detection.circle_index]
    extent_px = float(np.max(np.ptp(detection.centres_px, axis=0)))
    threshold = max(tuning.starts.least_px, tuning.starts.gross_share * extent_px)
    right = np.ones(len(detection), dtype=bool)
    try:
        _, mask = cv2.findHomography(sheet, detection.centres_px, cv2.RANSAC, threshold)
    except cv2.error:
        return right
    if mask is not None and np.count_nonzero(mask) >= FEWEST_PLACES:
        right = np.asarray(mask).reshape(-1).astype(bool)
    return right


def _zhang_matrix(
    sheet: list[np.ndarray], image: list[np.ndarray], size: tuple[int, int], aspect: float | None
) -> Float[np.ndarray, "3 3"] | None:
    """Zhang's closed formula; None where the pictures do not determine a focal length."""
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
    """Root mean square misfit in pixels, and the lens and poses that OpenCV reaches; None where it
    reaches none that could be."""
    flags = _HELD if aspect is None else _HELD | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        misfit_px, matrix, distortion, turns, shifts = cv2.calibrateCamera(
            sheet, image, size, guess.copy(), np.zeros(5), flags=flags
        )
    except cv2.error:
        return None
    poses = tuple(
        Pose(np.column_stack([cv2.Rodrigues(turn)[0], np.ravel(shift)]))
        for turn, shift in zip(turns, shifts, strict=True)
    )
    lens = BrownConrady(
        np.diag(matrix)[:2].copy(), matrix[:2, 2].copy(), np.zeros(()), distortion.ravel()[:5]
    )
    sound = np.isfinite([misfit_px, *lens.parameters]).all() and (lens.focal_length_px > 0).all()
    in_front = all(pose.translation_mm[2] > 0 for pose in poses)
    return (float(misfit_px), CameraStart(lens, poses)) if sound and in_front else None
