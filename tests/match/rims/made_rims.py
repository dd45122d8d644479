"""Chords of circles, cut at different points in every view, as by a detector."""

import numpy as np

from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import Segments
from trinoc.numerics.vectors import complete_axes

SIGMA_PX = 0.2
# Where a chord crosses its arc, as shares of the whole.
ON_ARC = (1 - 1 / np.sqrt(3)) / 2


class Ring:
    """A circle in space."""

    def __init__(self, centre_mm, normal, radius_mm):
        self.centre_mm = np.asarray(centre_mm, dtype=float)
        self.normal = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
        self.radius_mm = float(radius_mm)

    def at(self, angle: np.ndarray) -> np.ndarray:
        """Points on the circle at these angles."""
        around = np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ complete_axes(self.normal)
        return self.centre_mm + self.radius_mm * around


def chords_seen(rig: Rig, rings, lines_mm=None, *, sigma_px=0.0, number=14, seed=0):
    """Segments of every view: the chords of each ring in turn, then the lines."""
    rng = np.random.default_rng(seed)
    lines_mm = np.zeros((0, 2, 3)) if lines_mm is None else lines_mm
    segments = {}
    for view, (name, camera) in enumerate(rig.items()):
        matrix = np.asarray(camera.matrix_px)
        parts = []
        for ring in rings:
            cut = (np.arange(number) + 0.31 * view) * 2 * np.pi / number
            step = 2 * np.pi / number
            angle = cut[:, None] + step * np.array([ON_ARC, 1 - ON_ARC])
            arc_px = projected(matrix, ring.at(angle))
            arc_px = arc_px + sigma_px * rng.normal(size=arc_px.shape) / np.sqrt(2)
            half = (arc_px[:, 1] - arc_px[:, 0]) / (1 - 2 * ON_ARC) / 2
            middle = arc_px.mean(axis=1)
            parts.append(np.stack([middle - half, middle + half], axis=1))
        parts.append(projected(matrix, lines_mm))
        segments[name] = Segments.from_endpoints(np.concatenate(parts), sigma_px=SIGMA_PX)
    return segments


def projected(matrix_px: np.ndarray, points_mm: np.ndarray) -> np.ndarray:
    """Pixels of points (..., 3), (..., 2)."""
    image = points_mm @ matrix_px[:, :3].T + matrix_px[:, 3]
    return image[..., :2] / image[..., 2:]
