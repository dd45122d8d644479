"""Stereo rectification: two ideal cameras in which a point has the same row in both images.

Both image planes are parallel to the baseline b, at the same distance f. The columns of a point at
depth z differ by f b / z. Source: Hartley and Zisserman, section 11.12.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.ideal_cameras import (
    camera_name_in_errors,
    expect_alpha,
    ideal_lens,
    with_covariance,
)
from trinoc.geometry.intrinsics import whole_size_px
from trinoc.geometry.picture_window import (
    CAMERA_FRAME,
    WIDEST_DEG,
    border_in_plane,
    fit_windows,
)
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points, unproject_pixels
from trinoc.geometry.rig import Rig, find_equal_centres
from trinoc.numerics.precision import in_float64

# Beyond, pixels at the border are stretched more than tenfold.
_MOST_TURN_DEG = 60.0
# The sine of the angle with the line under which a camera would be turned that far.
_ALONG = np.sin(np.radians(90 - _MOST_TURN_DEG))
# Share of the common field: an error below the first, a note below the second.
LEAST_SHARE, NOTED_SHARE = 0.1, 0.75
# numerical: points of the field along each side of a picture; a great distance, in baselines.
_FIELD_STEPS, _FAR = 33, 100.0


class Disparity(NamedTuple):
    """Relation between disparity and depth in two rectified images.

    The disparity is u in the first image minus u in the second, px.

    Attributes
    ----------
    first, second : str
        Names of the cameras.
    offset_px : float
        Disparity of points at infinity.
    product_px_mm : float
        Focal length times baseline. Negative if the second camera is on the left of the first.
    """

    first: str
    second: str
    offset_px: float
    product_px_mm: float

    def depth_mm(self, difference_px: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Convert disparities, px, to depths, mm."""
        return self.product_px_mm / (difference_px - self.offset_px)


@in_float64
def rectify_pair(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> tuple[Rig, Disparity]:
    """Rectify two cameras: a scene point then has the same row in both images.

    Parameters
    ----------
    rig : Rig
        Exactly two cameras.
    alpha : float
        Part of the field of view that the new images show, as in `undistort_lens`.
    image_size_px : (width, height), optional
        Size of both images. Default: the larger width and the larger height of the two.

    Returns
    -------
    Rig
        Two pinhole cameras with the same centres as before and a common rotation. Their covariance
        is propagated from the poses. The covariance is empty if `rig` has errors of lens
        parameters.
    Disparity
        Conversion from disparity to depth.

    Raises
    ------
    InputError
        If the rig does not have two cameras with different centres; if one camera looks along the
        baseline or has the other camera in its image; if the cameras have no common rows; if the
        new images show less than a tenth of the common field of view (`share_of_common_field`).
    """
    expect_alpha(alpha)
    if len(rig) != 2:
        raise InputError(
            f"Rectification needs two cameras, but the rig has {len(rig)}. Give a rig of two."
        )
    if find_equal_centres(dict(rig.items())) is not None:
        raise InputError(
            f'The cameras "{rig.names[0]}" and "{rig.names[1]}" have the same centre, so depth '
            "cannot be measured. Give two cameras with a baseline."
        )
    ideal_from_world = _common_rotation(rig)
    # The pixel shape is the geometric mean of those of both cameras.
    ratios = [np.divide(*camera.intrinsics.focal_length_px[::-1]) for camera in rig.cameras]
    shape = np.diag([1.0, float(np.exp(np.mean(np.log(ratios))))])
    borders = []
    for name, camera in rig.items():
        with camera_name_in_errors(name):
            border = border_in_plane(camera.intrinsics, ideal_from_world @ camera.pose.rotation.T)
        borders.append(border @ shape.T)
    sizes = zip(*(camera.image_size_px for camera in rig.cameras), strict=True)
    largest = tuple(max(sides) for sides in sizes)
    size_px = largest if image_size_px is None else whole_size_px(image_size_px)

    def fit_cameras(alpha: float) -> dict[str, Camera]:
        windows = fit_windows(borders, size_px, alpha)
        if windows is None:
            raise InputError(
                f"The images of {', '.join(rig.names)} have no common rows. Give cameras that look "
                "at the same scene."
            )
        return {
            name: Camera(
                ideal_lens(shape, windows.scale_px, origin_px, size_px),
                Pose.from_centre(ideal_from_world, camera.centre_world_mm),
            )
            for (name, camera), origin_px in zip(rig.items(), windows.origins_px, strict=True)
        }

    cameras = fit_cameras(alpha)
    share = share_of_common_field(rig, cameras)
    if share < LEAST_SHARE:
        full_share = share_of_common_field(rig, fit_cameras(1.0))
        remedy = (
            f"Give alpha 1, which keeps {100 * full_share:.0f} %, or "
            if full_share > LEAST_SHARE
            else "Give "
        )
        raise InputError(
            f"The new images would show {100 * share:.0f} % of the common field, because the "
            f"optical axes differ by {_angle_deg(rig):.0f} degrees. {remedy}cameras with more "
            "nearly parallel axes."
        )
    return with_covariance(cameras, rig), _disparity(cameras)


@in_float64
def share_of_common_field(rig: Rig, cameras: Mapping[str, Camera]) -> float:
    """Share, 0 to 1, of the common field of view of `rig` that both rectified `cameras` show.

    NaN if the two cameras of `rig` have no common field. The field is sampled on one plane for each
    camera, perpendicular to its optical axis. The plane has the depth at which the two axes are
    nearest to each other. If this point is not in front of the cameras, the depth is 100 baselines.
    """
    first, second = rig.cameras
    depths = _depths_of_approach(first, second)
    fields = []
    for camera, other, depth in ((first, second, depths[0]), (second, first, depths[1])):
        size = np.array(camera.image_size_px) - 1.0
        grid = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, _FIELD_STEPS)]), axis=-1)
        rays = unproject_pixels(camera.intrinsics.lens, grid.reshape(-1, 2) * size)
        rays = rays[rays[:, 2] > np.cos(np.radians(WIDEST_DEG))]
        in_camera = depth * rays / rays[:, 2:]
        points_mm = in_camera @ np.asarray(camera.pose.rotation) + camera.centre_world_mm
        fields.append(points_mm[_is_imaged(other, points_mm)])
    common = np.concatenate(fields)
    if not len(common):
        return float("nan")
    imaged = np.all([_is_imaged(camera, common) for camera in cameras.values()], axis=0)
    return float(imaged.mean())


def _is_imaged(camera: Camera, points_mm: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
    """Return True for world points in front of a camera and inside its image, (n,)."""
    in_camera = points_mm @ np.asarray(camera.cam_from_world)[:, :3].T
    in_camera = in_camera + np.asarray(camera.cam_from_world)[:, 3]
    uv_px = project_points(CAMERA_FRAME, camera.intrinsics.lens, in_camera)
    inside = ((uv_px >= -0.5) & (uv_px <= np.array(camera.image_size_px) - 0.5)).all(axis=1)
    return inside & (in_camera[:, 2] > 0)


def _depths_of_approach(first: Camera, second: Camera) -> tuple[float, float]:
    """Depth on each optical axis of the point nearest to the other camera's axis, mm.

    A large depth for both cameras if the axes are parallel or nearest behind a camera.
    """
    axes = np.stack([first.pose.rotation[2], second.pose.rotation[2]])
    baseline = np.asarray(second.centre_world_mm - first.centre_world_mm)
    far_mm = _FAR * float(np.linalg.norm(baseline))
    cosine = float(axes[0] @ axes[1])
    if 1 - cosine**2 < _FAR**-2:
        return far_mm, far_mm
    depths = np.linalg.solve([[1, -cosine], [cosine, -1]], axes @ baseline)
    is_in_front = (depths > 0).all() and (depths < far_mm).all()
    return (float(depths[0]), float(depths[1])) if is_in_front else (far_mm, far_mm)


def _angle_deg(rig: Rig) -> float:
    """Angle between the optical axes of the two cameras of a rig, degrees."""
    first, second = (camera.pose.rotation[2] for camera in rig.cameras)
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def _disparity(cameras: dict[str, Camera]) -> Disparity:
    (first_name, first), (second_name, second) = cameras.items()
    baseline = first.pose.rotation @ (second.centre_world_mm - first.centre_world_mm)
    offset = first.intrinsics.principal_point_px[0] - second.intrinsics.principal_point_px[0]
    product = float(first.intrinsics.focal_length_px[0] * baseline[0])
    return Disparity(first_name, second_name, float(offset), product)


def _common_rotation(rig: Rig) -> Float[np.ndarray, "3 3"]:
    """Rotation from the world to both rectified cameras, (3, 3).

    The first axis is the baseline. The third axis is the mean of the two viewing directions, made
    perpendicular to the baseline. Raise `InputError` if these directions are parallel.
    """
    first, second = (camera.centre_world_mm for camera in rig.cameras)
    right, _, forward = np.mean([camera.pose.rotation for camera in rig.cameras], axis=0)
    along = (second - first) / np.linalg.norm(second - first)
    along = along if along @ right >= 0 else -along
    level = forward - (forward @ along) * along
    length = np.linalg.norm(level)
    if not length > 1e-6:
        raise InputError(
            f"The cameras {', '.join(rig.names)} look along their baseline, or in opposite "
            "directions, so they have no common image plane. Give cameras side by side."
        )
    level = level / length
    rotation = np.stack([along, np.cross(level, along), level])
    _expect_directions(rig, rotation)
    return rotation


def _expect_directions(rig: Rig, ideal_from_world: Float[np.ndarray, "3 3"]) -> None:
    """Raise `InputError` if rectification is impossible for one of the two cameras.

    This is the case if the camera would turn by more than 60 degrees, or has the other camera in
    its image.
    """
    for (name, camera), (other, partner) in zip(rig.items(), [*rig.items()][::-1], strict=True):
        axis = np.asarray(camera.pose.rotation[2])
        turn_deg = float(np.degrees(np.arccos(np.clip(axis @ ideal_from_world[2], -1, 1))))
        if turn_deg > _MOST_TURN_DEG:
            raise InputError(
                f'The camera "{name}" would have to turn by {turn_deg:.0f} degrees, because '
                f"{_turn_reason(camera, partner, other)}. Rectify cameras that stand side by side "
                "and look at the same scene."
            )
        if _has_in_image(camera, partner):
            raise InputError(
                f'The camera "{other}" is in the image of "{name}", where all rows would meet. '
                "Rectify cameras that stand side by side."
            )


def _turn_reason(camera: Camera, partner: Camera, other: str) -> str:
    axis = camera.pose.rotation[2]
    baseline = partner.centre_world_mm - camera.centre_world_mm
    if float(axis @ partner.pose.rotation[2]) <= 0:
        return "the cameras look in opposite directions"
    if np.linalg.norm(np.cross(baseline, axis)) < _ALONG * np.linalg.norm(baseline):
        return f'it looks along the baseline to "{other}"'
    return "the two viewing directions differ too much"


def _has_in_image(camera: Camera, other: Camera) -> bool:
    """Return True if the line to the other camera, in either direction, meets the camera's image.

    Only directions within 75 degrees of the optical axis count: a rectified image shows no others.
    """
    ray = np.asarray(camera.pose.rotation @ (other.centre_world_mm - camera.centre_world_mm))
    ray = ray if ray[2] > 0 else -ray
    if ray[2] <= np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(ray):
        return False
    (uv_px,) = project_points(CAMERA_FRAME, camera.intrinsics.lens, ray[None])
    return bool(((uv_px >= 0) & (uv_px <= np.array(camera.image_size_px) - 1)).all())
