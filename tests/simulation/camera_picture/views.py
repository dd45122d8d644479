"""Small cameras and sheets that the tests of this room share."""

import numpy as np

from simulation.camera_picture.scene import Radiance
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics

SMALL_LENS = Intrinsics(focal_length_px=(190.0, 230.0), image_size_px=(96, 90))
SHEET = Pattern.cross_grid(rows=3, columns=3, pitch_mm=22.0, radius_mm=7.0)


def camera_of(lens: Intrinsics = SMALL_LENS, pan_deg: float = 25.0, tilt_deg: float = 40.0):
    return Camera.from_degrees(
        lens, pan_deg=pan_deg, tilt_deg=tilt_deg, swing_deg=3.0, distance_mm=300.0
    )


CELLS = 8


def cells_of(radiance: Radiance) -> np.ndarray:
    """The radiance of every cell, (CELLS h, CELLS w)."""
    fine = np.repeat(np.repeat(radiance.by_pixel, CELLS, axis=0), CELLS, axis=1)
    height, width = radiance.by_pixel.shape
    row, column = radiance.divided.T
    fine.reshape(height, CELLS, width, CELLS)[row, :, column] = radiance.by_cell
    return fine


def radiance_of(cells: np.ndarray, margin_px: int) -> Radiance:
    """Radiance in which every pixel is divided into the given cells."""
    height, width = (side // CELLS for side in cells.shape)
    by_cell = cells.reshape(height, CELLS, width, CELLS).swapaxes(1, 2)
    divided = np.argwhere(np.ones((height, width), dtype=bool))
    by_pixel = by_cell.mean(axis=(2, 3))
    return Radiance(by_pixel, divided, by_cell.reshape(-1, CELLS, CELLS), margin_px)
