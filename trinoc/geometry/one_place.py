"""Cameras that stand at one place: nothing between them has a depth."""

import itertools
from collections.abc import Mapping

import numpy as np

from trinoc.geometry.camera import Camera

# Centres nearer to each other than this share of their distance from the sheet are one place.
_ONE_PLACE = 1e-6


def at_one_place(cameras: Mapping[str, Camera]) -> tuple[str, str] | None:
    """The names of two cameras that stand at one place; None where there are none."""
    centres = {name: np.asarray(camera.centre_world_mm) for name, camera in cameras.items()}
    for first, second in itertools.combinations(cameras, 2):
        a, b = centres[first], centres[second]
        if np.linalg.norm(a - b) <= _ONE_PLACE * max(np.linalg.norm(a), np.linalg.norm(b)):
            return first, second
    return None
