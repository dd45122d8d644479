"""Detect mirrored cameras: they look away from the scene instead of at a common part of it.

A projection matrix does not show whether it is mirrored. Its sign is free, and a mirrored camera
is a proper camera that looks the other way. But all mirrored cameras of a scene look away from
it. Two of them have no common field of view, or only a distant one, and would have a common
field behind them. If such cameras give few matches, the number of matches behind them decides.
"""

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig
from trinoc.match import sentences

# numerical: rays per side of a grid over the image.
RAYS = 9


def check_not_mirrored(cameras: Mapping[str, Camera]) -> None:
    """Raise `InputError` if a camera is mirrored.

    Its rotation has determinant -1, or the scene of the other cameras lies behind the camera.
    """
    for name, camera in cameras.items():
        if np.linalg.det(np.asarray(camera.cam_from_world)[:, :3]) < 0:
            raise InputError(sentences.camera_mirrored(name, sentences.NEGATIVE_DETERMINANT))
    pairs = list(combinations(cameras, 2))

    def pairs_with_common_space(sides: tuple[int, int]) -> list[tuple[str, str]]:
        return [(a, b) for a, b in pairs if _see_common_space(cameras[a], cameras[b], *sides)]

    views_facing = {name for pair in pairs_with_common_space((1, 1)) for name in pair}
    if len(views_facing) == len(cameras):
        return
    views_facing_away = {
        name
        for sides in ((1, -1), (-1, 1), (-1, -1))
        for pair in pairs_with_common_space(sides)
        for name, side in zip(pair, sides, strict=True)
        if side < 0
    }
    for name in cameras:
        if name in views_facing_away and name not in views_facing:
            raise InputError(sentences.camera_mirrored(name, sentences.SCENE_BEHIND))


def views_diverge(cameras: Mapping[str, Camera]) -> bool:
    """True if every pair of cameras has a common field of view behind both cameras."""
    pairs = combinations(cameras.values(), 2)
    return all(_see_common_space(first, second, -1, -1) for first, second in pairs)


def mirror_rig(rig: Rig) -> Rig:
    """Return the rig in a mirrored world, in which the space behind the cameras lies in front of
    them.
    """
    flip = -np.diag([1.0, 1.0, -1.0, 1.0])
    return Rig(
        {
            name: Camera(camera.intrinsics, Pose(np.asarray(camera.cam_from_world) @ flip))
            for name, camera in rig.items()
        }
    )


def mirrored_rig_error(names: Iterable[str], before: int, behind: int) -> InputError:
    """Return the error for a mirrored rig.

    `before` and `behind` are the numbers of lines in front of the cameras and behind the cameras.
    """
    return InputError(sentences.rig_mirrored(names, before, behind))


def _see_common_space(first: Camera, second: Camera, side_first: int, side_second: int) -> bool:
    """True if a ray of the first camera passes through the second camera's field of view.

    `side_first` and `side_second` are 1 for the space in front of the camera, -1 for that behind
    it.
    """
    matrix = np.asarray(second.matrix_px)
    centre = np.asarray(first.centre_world_mm)
    start = matrix @ np.append(centre, 1.0)
    ray_step = side_first * _rays(first) @ matrix[:, :3].T
    width, height = second.image_size_px
    # The ray is inside the image where all of these are positive. Each is linear along the ray.
    inequalities = side_second * np.array(
        [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, width], [0, -1, height]]
    )
    constant, slope = inequalities @ start, ray_step @ inequalities.T
    root = -constant / np.where(slope == 0, 1e-300, slope)
    low = np.where(slope > 0, root, 0.0).max(axis=1, initial=0.0)
    high = np.where(slope < 0, root, np.inf).min(axis=1)
    is_possible = ~((slope == 0) & (constant <= 0)).any(axis=1)
    return bool((is_possible & (low < high)).any())


def _rays(camera: Camera) -> Float[np.ndarray, "r 3"]:
    """Return the directions of viewing rays on a grid over the image, (r, 3), world frame."""
    width, height = camera.image_size_px
    u, v = np.meshgrid(np.linspace(0, width, RAYS), np.linspace(0, height, RAYS))
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return np.linalg.solve(np.asarray(camera.matrix_px)[:, :3], points.T).T
