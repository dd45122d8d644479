"""A first lens of one camera, and the pose of the board in each of its pictures."""

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib.detection import Detection
from trinoc.calib.intrinsics import zhang_start
from trinoc.calib.shots.plane_pose import plane_pose
from trinoc.calib.targets import AbstractTarget
from trinoc.errors import CalibrationError
from trinoc.geometry import AbstractLens, promoted
from trinoc.numerics import ArrayLike, in_bucket

# Focal lengths of a fisheye to start from, in longer sides of the picture.
_FISHEYE_SHARES = (0.2, 0.25, 0.3, 0.36, 0.45, 0.55, 0.7, 1.0, 1.4)


class CameraStart(NamedTuple):
    """Where the fit of one camera starts: a lens, and the board in each picture (k, 3, 4)."""

    lens: AbstractLens
    cam_from_board: Float[np.ndarray, "k 3 4"]


def camera_start(
    detections: Sequence[Detection],
    target: AbstractTarget,
    model: type[AbstractLens],
    lens: AbstractLens | None,
) -> CameraStart:
    """A start from nothing by Zhang's method, or for a fisheye by trying focal lengths; poses
    alone where the lens is given.

    Raises CalibrationError where no lens of the model puts the places near where they are seen.
    """
    if lens is not None:
        return with_poses(promoted(lens), detections, target)
    if model.zero_is_ideal:
        start = zhang_start(detections, target, model)
        return CameraStart(start.lens, start.cam_from_world)
    width, height = detections[0].image_size_px
    middle = np.array([0.5 * (width - 1), 0.5 * (height - 1)])
    none = np.zeros(len(model.coefficient_names))
    tried = []
    for share in _FISHEYE_SHARES:
        focal = np.full(2, share * max(width, height))
        tried.append(with_poses(model(focal, middle, np.zeros(()), none), detections, target))
    return min(tried, key=lambda start: _misfit_px(start, detections, target))


def with_poses(
    lens: AbstractLens, detections: Sequence[Detection], target: AbstractTarget
) -> CameraStart:
    """The pose of the board in each picture through a known lens."""
    poses = []
    for detection in detections:
        rays = rays_of_places(lens, detection.centres_px)
        pose = plane_pose(rays, target.centres_mm[detection.circle_index])
        if pose is None:
            raise CalibrationError(
                "The places found in a picture do not tell where the board stands: show more of it."
            )
        poses.append(pose)
    return CameraStart(lens, np.stack(poses))


def rays_of_places(lens: AbstractLens, uv_px: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "m 3"]:
    """Unit rays, in the camera's frame, that are imaged there."""
    return in_bucket(partial(_unprojected, lens), uv_px)


def places_px(
    lens: AbstractLens, cam_from_board: Float[np.ndarray, "3 4"], place_mm: Float[np.ndarray, "m 2"]
) -> Float[np.ndarray, "m 2"]:
    """Where a camera sees places of the board."""
    seen = place_mm @ cam_from_board[:, :2].T + cam_from_board[:, 3]
    return in_bucket(partial(_projected, lens), seen)


def miss_px(
    lens: AbstractLens,
    cam_from_board: Float[np.ndarray, "3 4"],
    detection: Detection,
    place_mm: Float[np.ndarray, "m 2"],
) -> float:
    """Median distance of what is seen from where it should be; infinite behind the camera."""
    off = places_px(lens, cam_from_board, place_mm) - detection.centres_px
    distance = np.linalg.norm(off, axis=1)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))


def _misfit_px(
    start: CameraStart, detections: Sequence[Detection], target: AbstractTarget
) -> float:
    misses = [
        miss_px(start.lens, pose, detection, target.centres_mm[detection.circle_index])
        for pose, detection in zip(start.cam_from_board, detections, strict=True)
    ]
    return float(np.median(misses))


@jax.jit
def _unprojected(lens: AbstractLens, uv_px: Float[ArrayLike, "m 2"]) -> Float[ArrayLike, "m 3"]:
    return jax.vmap(lens.unproject)(uv_px)


@jax.jit
def _projected(lens: AbstractLens, rays: Float[ArrayLike, "m 3"]) -> Float[ArrayLike, "m 2"]:
    return jax.vmap(lens.project_ray)(rays)
