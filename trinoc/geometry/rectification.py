"""Cameras without distortion, turned until the images of a point are in one row of two pictures and
in one column of a third.

All image planes are parallel to one plane through the centres, at one distance, so that a point at
depth z moves by f b / z from picture to picture, along the line b between the centres. Two cameras,
or several in one line, have that line as rows. Three others have a plane of their own; an affine
map of its picture, with a skew, makes the line from the first to the second a row, that from the
first to the third a column, and both steps equal. Sources: Hartley and Zisserman, section 11.12;
N. Ayache and C. Hansen, "Rectification of images for binocular and trinocular stereovision", 1988;
L. An, Y. Jia, J. Wang, X. Zhang and M. Li, "An efficient rectification method for trinocular
stereovision", 2004.
"""

import itertools
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.ideal_cameras import (
    expect_alpha,
    ideal_lens,
    say_which_camera,
    with_covariance,
)
from trinoc.geometry.ideal_field import WIDEST_DEG, Shared, border_in_plane, fit_windows
from trinoc.geometry.pose import Pose
from trinoc.geometry.projection import project_points
from trinoc.geometry.rig import Rig, at_one_place
from trinoc.numerics.precision import in_float64

# Beyond, pixels at the border are stretched more than tenfold.
_MOST_TURN_DEG = 60.0
# The sine of the angle with a line under which a camera would be turned that far.
_ALONG = np.sin(np.radians(90 - _MOST_TURN_DEG))
# Centres are in one line if one is off the line of the others by less of their distance.
_IN_LINE = 2e-3
# What three pictures may be stretched more in one direction than in another.
_MOST_STRETCH = 3.0
_OWN_FRAME = Pose(np.eye(3, 4))


class Disparity(NamedTuple):
    """What the pictures of two rectified cameras say of depth.

    Fields
    ------
    first, second : names of the cameras.
    along : "u" where points have equal rows, "v" where they have equal columns.
    offset_px : u (or v) in the first picture less that in the second, of points far away.
    product_px_mm : focal length times distance of the centres, negative where the second camera is
        on the other side.
    """

    first: str
    second: str
    along: Literal["u", "v"]
    offset_px: float
    product_px_mm: float

    def depth_mm(self, difference_px: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Depths of points by u (or v) in the first picture less that in the second."""
        return self.product_px_mm / (difference_px - self.offset_px)


class RectifiedRig(NamedTuple):
    """rig : cameras without distortion, at the same centres. disparities : of the first camera and
    each other one. notes : what does not hold exactly.
    """

    rig: Rig
    disparities: tuple[Disparity, ...]
    notes: tuple[str, ...]


@in_float64
def rectify_rig(
    rig: Rig, *, alpha: float = 0.0, image_size_px: tuple[int, int] | None = None
) -> RectifiedRig:
    """Ideal cameras at the places of two or three, turned so that a point has the same row.

    alpha : as of `undistort_lens`.
    image_size_px : (width, height) of all pictures, by default those of the largest given.

    Of two cameras, and of three in one line, a point has the same row in all. Of three others, it
    has the same row in the first and second, the same column in the first and third, and moves by
    equally much.

    The covariance is carried along, or none where lenses are not exact. Raises InputError for
    another number of cameras, cameras at one place, one that looks along the line (or plane) of the
    centres or sees another one, and cameras that see no common rows.
    """
    expect_alpha(alpha)
    _expect_rectifiable(rig)
    plane = _common_plane(rig)
    turned = plane.ideal_from_world
    borders = []
    for name, camera in rig.items():
        with say_which_camera(name):
            border = border_in_plane(camera.intrinsics, turned @ camera.pose.rotation.T)
        borders.append(border @ plane.shape.T)
    sizes = zip(*(camera.image_size_px for camera in rig.cameras), strict=True)
    size_px = image_size_px or tuple(max(sides) for sides in sizes)
    windows = fit_windows(borders, plane.shared, size_px, alpha)
    if windows is None:
        what = "rows and columns" if "column" in plane.shared else "rows"
        raise InputError(
            f"The pictures of {', '.join(rig.names)} show nothing in common {what}: give cameras "
            "that look at one scene."
        )
    cameras = {
        name: Camera(
            ideal_lens(plane.shape, windows.scale_px, origin_px, size_px),
            Pose.from_centre(turned, camera.centre_world_mm),
        )
        for (name, camera), origin_px in zip(rig.items(), windows.origins_px, strict=True)
    }
    disparities = _list_disparities(cameras, plane.shared)
    return RectifiedRig(with_covariance(cameras, rig), disparities, plane.notes)


def _list_disparities(
    cameras: dict[str, Camera], shared: tuple[Shared, ...]
) -> tuple[Disparity, ...]:
    (first, camera), *others = cameras.items()
    found = []
    for (name, other), what in zip(others, shared, strict=True):
        axis = 0 if what == "row" else 1
        # A point and a camera that moves look as the point that moves the other way.
        step = camera.pose.rotation @ (other.centre_world_mm - camera.centre_world_mm)
        principal_points = [each.intrinsics.principal_point_px for each in (camera, other)]
        found.append(
            Disparity(
                first,
                name,
                "u" if axis == 0 else "v",
                float(principal_points[0][axis] - principal_points[1][axis]),
                float((camera.intrinsics.matrix @ (step * np.array([1.0, 1.0, 0.0])))[axis]),
            )
        )
    return tuple(found)


def _expect_rectifiable(rig: Rig) -> None:
    if not 2 <= len(rig) <= 3:
        raise InputError(
            f"Two or three cameras are rectified together, but these are {len(rig)}: choose some."
        )
    pair = at_one_place(dict(rig.items()))
    if pair is not None:
        raise InputError(
            f'The cameras "{pair[0]}" and "{pair[1]}" stand at one place, so nothing between them '
            "has a depth: leave one out."
        )


class _CommonPlane(NamedTuple):
    """The plane of all pictures.

    Fields
    ------
    ideal_from_world : (3, 3) rotation of all ideal cameras.
    shape : (2, 2) upper triangle of K over its scale.
    shared : what the window of each camera but the first shares with the first.
    notes : what does not hold exactly.
    """

    ideal_from_world: Float[np.ndarray, "3 3"]
    shape: Float[np.ndarray, "2 2"]
    shared: tuple[Shared, ...]
    notes: tuple[str, ...] = ()


def _common_plane(rig: Rig) -> _CommonPlane:
    """The plane that turns the cameras least. Raises InputError."""
    centres = np.stack([camera.centre_world_mm for camera in rig.cameras])
    axes = np.stack([camera.pose.rotation for camera in rig.cameras])
    pairs = list(itertools.combinations(range(len(rig)), 2))
    i, j = max(pairs, key=lambda pair: float(np.linalg.norm(centres[pair[1]] - centres[pair[0]])))
    longest = np.linalg.norm(centres[j] - centres[i])
    along = (centres[j] - centres[i]) / longest
    off_mm = np.linalg.norm(np.cross(centres - centres[i], along), axis=1)
    if off_mm.max() > _IN_LINE * longest:
        return _plane_of_three(rig, centres, axes.mean(axis=0))
    notes = ()
    if off_mm.max() > 1e-9 * longest:
        k = int(np.argmax(off_mm))
        # Rows are compared with those of the first camera.
        others = centres[:1] if k else centres[1:]
        step_mm = np.linalg.norm(others - centres[k], axis=1).min()
        notes = (
            f'The camera "{rig.names[k]}" is {off_mm[k]:.3g} mm off the line of the others, so '
            f"its rows are off by up to {off_mm[k] / step_mm:.1e} of a point's disparity.",
        )
    right, _, forward = axes.mean(axis=0)
    along = along if along @ right >= 0 else -along
    level = forward - (forward @ along) * along
    _expect_one_side(rig, float(np.linalg.norm(level)))
    rotation = _axes(along, level / np.linalg.norm(level))
    _expect_directions(rig, rotation)
    # Pixels have the shape that they have in the cameras, in the mean.
    ratios = [np.divide(*camera.intrinsics.focal_length_px[::-1]) for camera in rig.cameras]
    ratio = float(np.exp(np.mean(np.log(ratios))))
    return _CommonPlane(rotation, np.diag([1.0, ratio]), ("row",) * (len(rig) - 1), notes)


def _plane_of_three(
    rig: Rig, centres: Float[np.ndarray, "3 3"], mean_axes: Float[np.ndarray, "3 3"]
) -> _CommonPlane:
    """The plane through three centres that are not in one line."""
    second, third = centres[1] - centres[0], centres[2] - centres[0]
    normal = np.cross(second, third)
    normal = normal / np.linalg.norm(normal)
    along = second / np.linalg.norm(second)
    towards = mean_axes[2] @ normal
    _expect_one_side(rig, abs(float(towards)))
    forward = normal if towards > 0 else -normal
    # Both turns by half a circle keep rows and columns; the one nearer to the cameras is taken.
    turns = [_axes(sign * along, forward) for sign in (1.0, -1.0)]
    rotation = max(turns, key=lambda turn: float((turn[:2] * mean_axes[:2]).sum()))
    _expect_directions(rig, rotation)
    across, down = (rotation @ third)[:2]
    shape = _shape_of_three(float(np.linalg.norm(second)), float(across), float(down))
    _expect_shape(rig, centres, shape)
    return _CommonPlane(rotation, shape, ("row", "column"))


def _shape_of_three(second: float, across: float, down: float) -> Float[np.ndarray, "2 2"]:
    """The map that leaves rows, makes (across, down) a column, and that step as long as the one by
    `second` along the rows."""
    return np.array([[1.0, -across / down], [0.0, second / abs(down)]])


def _expect_shape(
    rig: Rig, centres: Float[np.ndarray, "3 3"], shape: Float[np.ndarray, "2 2"]
) -> None:
    """Raise InputError where pictures would be stretched too much, with a better order."""
    stretch = np.linalg.cond(shape)
    if stretch <= _MOST_STRETCH:
        return
    others = {}
    for name, order in zip(rig.names, ([0, 1, 2], [1, 2, 0], [2, 0, 1]), strict=True):
        first, second, third = centres[order]
        length = np.linalg.norm(second - first)
        across = (third - first) @ (second - first) / length
        down = np.sqrt((third - first) @ (third - first) - across**2)
        others[name] = np.linalg.cond(_shape_of_three(float(length), float(across), float(down)))
    best = min(others, key=lambda name: others[name])
    advice = f"name {best} first" if others[best] <= _MOST_STRETCH else "rectify two at a time"
    raise InputError(
        f"Rows from {rig.names[0]} to {rig.names[1]} and columns from {rig.names[0]} to "
        f"{rig.names[2]} would stretch the pictures {stretch:.1f} times: {advice}."
    )


def _axes(
    right: Float[np.ndarray, "3"], forward: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3 3"]:
    """Rows x, y, z of a camera that looks `forward`, perpendicular to its `right`."""
    return np.stack([right, np.cross(forward, right), forward])


def _expect_one_side(rig: Rig, towards: float) -> None:
    """Raise InputError where the part of the mean axis that stands on the plane is none."""
    if not towards > 1e-6:
        raise InputError(
            f"The cameras {', '.join(rig.names)} look along their line or plane, or in opposite "
            "directions, so they have no common picture plane: give cameras side by side."
        )


def _expect_directions(rig: Rig, ideal_from_world: Float[np.ndarray, "3 3"]) -> None:
    """Raise InputError for a camera that would have to be turned too far, or that sees another."""
    forward = ideal_from_world[2]
    for name, camera in rig.items():
        axis = np.asarray(camera.pose.rotation[2])
        turn_deg = float(np.degrees(np.arccos(np.clip(axis @ forward, -1, 1))))
        if turn_deg > _MOST_TURN_DEG:
            raise InputError(
                f'The camera "{name}" would have to be turned by {turn_deg:.0f} degrees, because '
                f"{_reason(rig, name)}: rectify cameras that look at one scene from beside each "
                "other."
            )
        for other, partner in rig.items():
            if other != name and _sees(camera, partner):
                raise InputError(
                    f'The line to the camera "{other}" meets the picture of "{name}", where rows '
                    "would all be one point: rectify cameras that stand beside each other."
                )


def _reason(rig: Rig, name: str) -> str:
    axis = rig[name].pose.rotation[2]
    apart = min(float(axis @ camera.pose.rotation[2]) for camera in rig.cameras)
    if apart <= 0:
        return "the cameras look at opposite sides"
    for other, camera in rig.items():
        way = camera.centre_world_mm - rig[name].centre_world_mm
        if other != name and np.linalg.norm(np.cross(way, axis)) < _ALONG * np.linalg.norm(way):
            return f'it looks along its line to "{other}"'
    return "it looks along their plane" if len(rig) > 2 else "both look too far apart"


def _sees(camera: Camera, other: Camera) -> bool:
    """Whether the line to another camera meets the picture, no farther than WIDEST_DEG from its
    axis: beyond, an ideal picture shows nothing anyway."""
    way = camera.pose.rotation @ (other.centre_world_mm - camera.centre_world_mm)
    ray = np.asarray(way if way[2] > 0 else -way)
    if ray[2] <= np.cos(np.radians(WIDEST_DEG)) * np.linalg.norm(ray):
        return False
    (uv_px,) = project_points(_OWN_FRAME, camera.intrinsics.lens, ray[None])
    return bool(((uv_px >= 0) & (uv_px <= np.array(camera.image_size_px) - 1)).all())
