"""Two cameras without distortion, turned until a point has the same row in both pictures.

Both image planes are parallel to the line between the centres, at one distance. A point at depth z
then moves by f b / z along the rows from picture to picture. Source: Hartley and Zisserman, section
11.12.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.ideal_cameras import (
    expect_alpha,
    ideal_lens,
    say_which_camera,
    with_covariance,
)
from trinoc.geometry.intrinsics import whole_size_px
from trinoc.geometry.picture_window import WIDEST_DEG, border_in_plane, fit_windows
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points, unproject_pixels
from trinoc.geometry.rig import Rig, at_one_place
from trinoc.numerics.precision import in_float64

# Beyond, pixels at the border are stretched more than tenfold.
_MOST_TURN_DEG = 60.0
# The sine of the angle with the line under which a camera would be turned that far.
_ALONG = np.sin(np.radians(90 - _MOST_TURN_DEG))
_OWN_FRAME = Pose(np.eye(3, 4))
# Of the field that both cameras see: less than this is no pair, and less than that is noted.
LEAST_SHARE, NOTED_SHARE = 0.1, 0.75
# numerical: points of the field along each side of a picture; a great distance, in baselines.
_FIELD_STEPS, _FAR = 33, 100.0


class Disparity(NamedTuple):
    """Relation between disparity and depth in two rectified pictures.

    Fields
    ------
    first, second : names of the cameras.
    offset_px : u in the first picture less u in the second, of points at infinity.
    product_px_mm : focal length times distance of the centres, negative where the second camera is
        on the left of the first.
    """

    first: str
    second: str
    offset_px: float
    product_px_mm: float

    def depth_mm(self, difference_px: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Depths of points from u in the first picture less u in the second."""
        return self.product_px_mm / (difference_px - self.offset_px)


@in_float64
def rectify_pair(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> tuple[Rig, Disparity]:
    """Ideal cameras at the centres of two cameras, with equal rows, and their disparity.

    alpha : as of `undistort_lens`.
    image_size_px : (width, height) of both pictures, by default those of the larger one.

    The covariance of the poses is propagated; where lenses are not exact, there is none. Raises
    InputError for another number of cameras, cameras at one place, a camera that looks along the
    line of the centres or sees the other one, cameras that see no common rows, and where less than
    a tenth of the common field is left (`share_of_common_field`).
    """
    expect_alpha(alpha)
    if len(rig) != 2:
        raise InputError(f"Two cameras are rectified together, but these are {len(rig)}: give two.")
    if at_one_place(dict(rig.items())) is not None:
        raise InputError(
            f'The cameras "{rig.names[0]}" and "{rig.names[1]}" stand at one place, so nothing '
            "between them has a depth: give two others."
        )
    ideal_from_world = _common_rotation(rig)
    # Pixels have the shape that they have in the cameras, in the mean.
    ratios = [np.divide(*camera.intrinsics.focal_length_px[::-1]) for camera in rig.cameras]
    shape = np.diag([1.0, float(np.exp(np.mean(np.log(ratios))))])
    borders = []
    for name, camera in rig.items():
        with say_which_camera(name):
            border = border_in_plane(camera.intrinsics, ideal_from_world @ camera.pose.rotation.T)
        borders.append(border @ shape.T)
    sizes = zip(*(camera.image_size_px for camera in rig.cameras), strict=True)
    largest = tuple(max(sides) for sides in sizes)
    size_px = largest if image_size_px is None else whole_size_px(image_size_px)

    def frame_pictures(alpha: float) -> dict[str, Camera]:
        windows = fit_windows(borders, size_px, alpha)
        if windows is None:
            raise InputError(
                f"The pictures of {', '.join(rig.names)} show nothing in common rows: give cameras "
                "that look at one scene."
            )
        return {
            name: Camera(
                ideal_lens(shape, windows.scale_px, origin_px, size_px),
                Pose.from_centre(ideal_from_world, camera.centre_world_mm),
            )
            for (name, camera), origin_px in zip(rig.items(), windows.origins_px, strict=True)
        }

    cameras = frame_pictures(alpha)
    share = share_of_common_field(rig, cameras)
    if share < LEAST_SHARE:
        whole = share_of_common_field(rig, frame_pictures(1.0))
        remedy = (
            f"give alpha 1, which keeps {100 * whole:.0f} %, or "
            if whole > LEAST_SHARE
            else "give "
        )
        raise InputError(
            f"The new pictures would show {100 * share:.0f} % of what both cameras look at, since "
            f"their directions differ by {_angle_deg(rig):.0f} degrees: {remedy}cameras that look "
            "in more nearly the same direction."
        )
    return with_covariance(cameras, rig), _disparity(cameras)


@in_float64
def share_of_common_field(rig: Rig, cameras: Mapping[str, Camera]) -> float:
    """Of the places that both cameras of a rig image: the share that both new `cameras` image.

    The places are where the optical axes come nearest to each other, on planes across the axes; at
    a great distance for axes that do not come nearer in front of the cameras. NaN for none.
    """
    first, second = rig.cameras
    depths = _depths_of_approach(first, second)
    points = []
    for camera, other, depth in ((first, second, depths[0]), (second, first, depths[1])):
        size = np.array(camera.image_size_px) - 1.0
        grid = np.stack(np.meshgrid(*2 * [np.linspace(0, 1, _FIELD_STEPS)]), axis=-1)
        rays = unproject_pixels(camera.intrinsics.lens, grid.reshape(-1, 2) * size)
        rays = rays[rays[:, 2] > np.cos(np.radians(WIDEST_DEG))]
        in_camera = depth * rays / rays[:, 2:]
        places = in_camera @ np.asarray(camera.pose.rotation) + camera.centre_world_mm
        points.append(places[_is_imaged(other, places)])
    common = np.concatenate(points)
    if not len(common):
        return float("nan")
    kept = np.all([_is_imaged(camera, common) for camera in cameras.values()], axis=0)
    return float(kept.mean())


def _is_imaged(camera: Camera, points_mm: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, "n"]:
    """Whether a picture shows points."""
    in_camera = points_mm @ np.asarray(camera.cam_from_world)[:, :3].T
    in_camera = in_camera + np.asarray(camera.cam_from_world)[:, 3]
    uv_px = project_points(_OWN_FRAME, camera.intrinsics.lens, in_camera)
    inside = ((uv_px >= -0.5) & (uv_px <= np.array(camera.image_size_px) - 0.5)).all(axis=1)
    return inside & (in_camera[:, 2] > 0)


def _depths_of_approach(first: Camera, second: Camera) -> tuple[float, float]:
    """How far along each optical axis the other one is nearest."""
    axes = np.stack([first.pose.rotation[2], second.pose.rotation[2]])
    baseline = np.asarray(second.centre_world_mm - first.centre_world_mm)
    far_mm = _FAR * float(np.linalg.norm(baseline))
    cosine = float(axes[0] @ axes[1])
    if 1 - cosine**2 < _FAR**-2:
        return far_mm, far_mm
    depths = np.linalg.solve([[1, -cosine], [cosine, -1]], axes @ baseline)
    near = (depths > 0).all() and (depths < far_mm).all()
    return (float(depths[0]), float(depths[1])) if near else (far_mm, far_mm)


def _angle_deg(rig: Rig) -> float:
    """Between the optical axes of two cameras."""
    first, second = (camera.pose.rotation[2] for camera in rig.cameras)
    return float(np.degrees(np.arccos(np.clip(first @ second, -1, 1))))


def _disparity(cameras: dict[str, Camera]) -> Disparity:
    (first_name, first), (second_name, second) = cameras.items()
    baseline = first.pose.rotation @ (second.centre_world_mm - first.centre_world_mm)
    offset = first.intrinsics.principal_point_px[0] - second.intrinsics.principal_point_px[0]
    product = float(first.intrinsics.focal_length_px[0] * baseline[0])
    return Disparity(first_name, second_name, float(offset), product)


def _common_rotation(rig: Rig) -> Float[np.ndarray, "3 3"]:
    """The rotation from the world to both ideal cameras, which turns the cameras least.

    Raises InputError.
    """
    first, second = (camera.centre_world_mm for camera in rig.cameras)
    right, _, forward = np.mean([camera.pose.rotation for camera in rig.cameras], axis=0)
    along = (second - first) / np.linalg.norm(second - first)
    along = along if along @ right >= 0 else -along
    level = forward - (forward @ along) * along
    length = np.linalg.norm(level)
    if not length > 1e-6:
        raise InputError(
            f"The cameras {', '.join(rig.names)} look along their line, or in opposite "
            "directions, so they have no common picture plane: give cameras side by side."
        )
    level = level / length
    rotation = np.stack([along, np.cross(level, along), level])
    _expect_directions(rig, rotation)
    return rotation


def _expect_directions(rig: Rig, ideal_from_world: Float[np.ndarray, "3 3"]) -> None:
    """Raise InputError for a camera that would be turned too far, or that sees the other one."""
    for (name, camera), (other, partner) in zip(rig.items(), [*rig.items()][::-1], strict=True):
        axis = np.asarray(camera.pose.rotation[2])
        turn_deg = float(np.degrees(np.arccos(np.clip(axis @ ideal_from_world[2], -1, 1))))
        if turn_deg > _MOST_TURN_DEG:
            raise InputError(
                f'The camera "{name}" would have to be turned by {turn_deg:.0f} degrees, because '
                f"{_reason(camera, partner, other)}: rectify cameras that look at one scene from "
                "beside each other."
            )
        if _sees(camera, partner):
            raise InputError(
                f'The line to the camera "{other}" meets the picture of "{name}", where rows '
                "would all be one point: rectify cameras that stand beside each other."
            )


def _reason(camera: Camera, partner: Camera, other: str) -> str:
    axis = camera.pose.rotation[2]
    baseline = partner.centre_world_mm - camera.centre_world_mm
    if float(axis @ partner.pose.rotation[2]) <= 0:
        return "the cameras look at opposite sides"
    if np.linalg.norm(np.cross(baseline, axis)) < _ALONG * np.linalg.norm(baseline):
        return f'it looks along its line to "{other}"'
    return "both look too far apart"


def _sees(camera: Camera, other: Camera) -> bool:
    """Whether the line to another camera meets the picture within WIDEST_DEG of its axis.

    Beyond that angle, an ideal picture shows nothing.
    """
    ray = np.asarray(camera.pose.rotation @ (other.centre_world_mm - camera.centre_world_mm))
    ray = ray if ray[2] > 0 else -ray
    if ray[2] <= np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(ray):
        return False
    (uv_px,) = project_points(_OWN_FRAME, camera.intrinsics.lens, ray[None])
    return bool(((uv_px >= 0) & (uv_px <= np.array(camera.image_size_px) - 1)).all())
