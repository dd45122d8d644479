"""Initial camera from points with known coordinates: its pose, or pose and lens.

Source: "resection" in Hartley and Zisserman, Multiple View Geometry, chapter 7.
"""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float

from trinoc.calib.tuning.every_group import TUNING, CalibTuning
from trinoc.errors import CalibrationError
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.pose import Pose

_LEFT_HANDED = (
    "The points appear behind the camera or mirrored: their frame is left-handed, or v is counted "
    "upward; reverse one axis of the points, or count v downward."
)
# numerical: SQPnP does not minimise pixel errors; its pose has this error.
_SOLVER_PX = 1e-3


def is_flat(points: Float[np.ndarray, "n 3"]) -> bool:
    """True if the points lie on one plane or on one line."""
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(spread[2] < 1e-6 * spread[0])


def find_pose(
    points: Float[np.ndarray, "n 3"],
    pixels: Float[np.ndarray, "n 2"],
    lens: Intrinsics,
    *,
    tuning: CalibTuning = TUNING,
) -> Pose:
    """Pose of a camera from 3-D points and their pixels, by SQPnP (Terzakis and Lourakis 2020).

    Raises `CalibrationError` if no pose has the points in front of the camera. Also raises it if
    the mirrored points fit significantly better, since their frame is then left-handed.
    """
    pose = _solve_pose(points, pixels, lens)
    if not is_flat(points):
        mirrored = points * [1.0, 1.0, -1.0]
        mirrored_pose = _solve_pose(mirrored, pixels, lens)
        if mirrored_pose is not None and (
            pose is None
            or _fits_better((mirrored_pose, mirrored), (pose, points), pixels, lens, tuning)
        ):
            raise CalibrationError(_LEFT_HANDED)
    if pose is None:
        raise CalibrationError(
            f"No pose has all {len(points)} points in front of the camera: check that points and "
            "pixels belong together, and that the frame of the points is right-handed."
        )
    return pose


def _solve_pose(
    points: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], lens: Intrinsics
) -> Pose | None:
    """Pose by SQPnP. None if no pose has the points in front of the camera.

    Raises `CalibrationError` if all points are the same.
    """
    rays = np.asarray(jax.vmap(lens.normalised_from_pixel)(jnp.asarray(pixels)))
    try:
        success, rotation, translation = cv2.solvePnP(
            points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_SQPNP
        )
    except cv2.error as error:  # of points that are all one
        raise CalibrationError(
            f"The {len(points)} points do not spread enough to determine a pose: give points that "
            "spread in depth and across the image."
        ) from error
    if not success:
        return None
    return Pose(np.concatenate([cv2.Rodrigues(rotation)[0], translation.reshape(3, 1)], axis=1))


def _fits_better(
    first: tuple[Pose, np.ndarray],
    second: tuple[Pose, np.ndarray],
    pixels: Float[np.ndarray, "n 2"],
    lens: Intrinsics,
    tuning: CalibTuning,
) -> bool:
    """True if the first (pose, points) has significantly smaller residuals than the second (F
    test).

    The test compares medians of the residuals, on which outliers have little effect.
    """
    medians = []
    for pose, points in (first, second):
        project = jax.vmap(Camera(lens, pose).project)
        residuals = np.linalg.norm(np.asarray(project(jnp.asarray(points))) - pixels, axis=1)
        medians.append(float(np.median(residuals)) + _SOLVER_PX)
    freedom = 2 * len(pixels) - 6
    p_value = scipy.special.fdtrc(freedom, freedom, (medians[1] / medians[0]) ** 2)
    return bool(p_value < tuning.answer.chance)


def find_linear_camera(
    points: Float[np.ndarray, "n 3"], pixels: Float[np.ndarray, "n 2"], size_px: tuple[int, int]
) -> Camera:
    """Camera from 3-D points and their pixels, by the direct linear transform with normalised data.

    The estimated skew is set to 0. Raises `CalibrationError` for a left-handed frame.

    size_px : (width, height) of the image.
    """
    middle, spread = points.mean(axis=0), points.std()
    centre, width = pixels.mean(axis=0), pixels.std()
    unit = np.concatenate([(points - middle) / spread, np.ones((len(points), 1))], axis=1)
    x, y = ((pixels - centre) / width).T
    zero = np.zeros_like(unit)
    rows = np.concatenate(
        [
            np.concatenate([unit, zero, -x[:, None] * unit], axis=1),
            np.concatenate([zero, unit, -y[:, None] * unit], axis=1),
        ]
    )
    matrix = np.linalg.eigh(rows.T @ rows)[1][:, 0].reshape(3, 4)
    to_world = np.diag([1 / spread] * 3 + [1.0])
    to_world[:3, 3] = -middle / spread
    from_unit = np.array([[width, 0, centre[0]], [0, width, centre[1]], [0, 0, 1]])
    camera = Camera.from_matrix(from_unit @ matrix @ to_world, size_px)
    depth = points @ camera.cam_from_world[2, :3] + camera.cam_from_world[2, 3]
    if np.median(depth) <= 0:
        raise CalibrationError(_LEFT_HANDED)
    # A real sensor has no skew.
    lens = camera.intrinsics
    unskewed = Intrinsics(
        focal_length_px=np.asarray(lens.focal_length_px),
        principal_point_px=np.asarray(lens.principal_point_px),
        image_size_px=size_px,
    )
    return Camera(unskewed, camera.pose)
