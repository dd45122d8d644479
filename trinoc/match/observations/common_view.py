"""Whether cameras look at a common place, or away from it, as mirrored ones do.

A matrix does not show whether it is mirrored: its sign is free, and the mirror image of a camera is
a proper one that looks the other way. But mirrored cameras of a scene all look away from it, so
that two of them see nothing in common, or too far off, and would see much if what is behind them
were before them. Where only few matches are found before such cameras, those behind decide.
"""

from collections.abc import Iterable, Mapping
from itertools import combinations

import numpy as np
from jaxtyping import Float

from trinoc.errors import InputError, list_names
from trinoc.geometry.camera import Camera
from trinoc.geometry.pose import Pose
from trinoc.geometry.rig import Rig

# numerical: rays from each side of a picture, over all of it.
RAYS = 9


def check_not_mirrored(cameras: Mapping[str, Camera]) -> None:
    """Raise InputError where a camera is mirrored: by its rotation, or by where it looks."""
    for name, camera in cameras.items():
        if np.linalg.det(np.asarray(camera.cam_from_world)[:, :3]) < 0:
            raise InputError(_sentence(name, "its rotation has determinant -1"))
    pairs = list(combinations(cameras, 2))

    def see_together(sides: tuple[int, int]) -> list[tuple[str, str]]:
        return [(a, b) for a, b in pairs if _share_a_place(cameras[a], cameras[b], *sides)]

    before = {name for pair in see_together((1, 1)) for name in pair}
    if len(before) == len(cameras):
        return
    behind = {
        name
        for sides in ((1, -1), (-1, 1), (-1, -1))
        for pair in see_together(sides)
        for name, side in zip(pair, sides, strict=True)
        if side < 0
    }
    for name in cameras:
        if name in behind and name not in before:
            why = "what it shares with the others lies behind it"
            raise InputError(_sentence(name, why))


def views_diverge(cameras: Mapping[str, Camera]) -> bool:
    """Whether all cameras, two by two, see common places behind them: they diverge."""
    pairs = combinations(cameras.values(), 2)
    return all(_share_a_place(first, second, -1, -1) for first, second in pairs)


def mirror_rig(rig: Rig) -> Rig:
    """The same cameras in a mirrored world: what was behind them lies before them."""
    flip = -np.diag([1.0, 1.0, -1.0, 1.0])
    return Rig(
        {
            name: Camera(camera.intrinsics, Pose(np.asarray(camera.cam_from_world) @ flip))
            for name, camera in rig.items()
        }
    )


def mirrored_rig_error(names: Iterable[str], before: int, behind: int) -> InputError:
    """What to raise where more lines lie behind all cameras than before them."""
    return InputError(
        f"The rig of {list_names(names)} is mirrored: {behind} lines lie behind its cameras and "
        f"{before} before them: give the matrices of unmirrored pictures in a right-handed world."
    )


def _sentence(name: str, why: str) -> str:
    return (
        f'Camera "{name}" is mirrored or looks the wrong way ({why}): give the matrix of the '
        "unmirrored picture in a right-handed world, with x to the right and y down."
    )


def _share_a_place(first: Camera, second: Camera, side_first: int, side_second: int) -> bool:
    """Whether a ray of the first camera's picture passes through the second's, each before (1) or
    behind (-1) its camera."""
    matrix = np.asarray(second.matrix_px)
    centre = np.asarray(first.centre_world_mm)
    start = matrix @ np.append(centre, 1.0)
    way = side_first * _rays(first) @ matrix[:, :3].T
    width, height = second.image_size_px
    # Where the ray is inside the picture, each of these is positive: all linear along the ray.
    inside = side_second * np.array(
        [[0, 0, 1], [1, 0, 0], [0, 1, 0], [-1, 0, width], [0, -1, height]]
    )
    constant, slope = inside @ start, way @ inside.T
    root = -constant / np.where(slope == 0, 1e-300, slope)
    low = np.where(slope > 0, root, 0.0).max(axis=1, initial=0.0)
    high = np.where(slope < 0, root, np.inf).min(axis=1)
    possible = ~((slope == 0) & (constant <= 0)).any(axis=1)
    return bool((possible & (low < high)).any())


def _rays(camera: Camera) -> Float[np.ndarray, "r 3"]:
    """Directions, forward, of rays over all of the picture."""
    width, height = camera.image_size_px
    u, v = np.meshgrid(np.linspace(0, width, RAYS), np.linspace(0, height, RAYS))
    points = np.column_stack([u.ravel(), v.ravel(), np.ones(u.size)])
    return np.linalg.solve(np.asarray(camera.matrix_px)[:, :3], points.T).T
