"""What COLMAP's files say of cameras and images, before it becomes a rig."""

from typing import NamedTuple

import numpy as np

from trinoc.io.formats.motions import (
    chain_motions,
    inverse,
    motion,
    quaternion_wxyz,
    rotation_of_quaternion as rotation_of,
)


class ColmapCamera(NamedTuple):
    """A lens: name of its model, (width, height), numbers in the order of the model."""

    model: str
    size: tuple[int, int]
    parameters: list[float]


class ColmapImage(NamedTuple):
    """A picture: cam_from_world as (w, x, y, z) and translation, and the camera it is of."""

    number: int
    wxyz: list[float]
    translation: list[float]
    camera: int
    name: str


class ColmapRecords(NamedTuple):
    """Cameras by number, and images in the order of the file."""

    cameras: dict[int, ColmapCamera]
    images: list[ColmapImage]

    def sensor_poses(self) -> list[tuple[int, list[float]]]:
        """(camera, quaternion and translation from the first one) of all but the first."""
        poses = [
            motion(rotation_of(np.array(image.wxyz), "a pose"), np.array(image.translation), "it")
            for image in self.images
        ]
        found = []
        for image, pose in zip(self.images[1:], poses[1:], strict=True):
            step = chain_motions(pose, inverse(poses[0]))
            numbers = [*quaternion_wxyz(step[:, :3]).tolist(), *step[:, 3].tolist()]
            found.append((image.camera, numbers))
        return found
