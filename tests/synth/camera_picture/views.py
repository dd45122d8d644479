"""Small cameras and sheets that the tests of this room share."""

from trinoc.calib import Pattern
from trinoc.geometry import Camera, Intrinsics

SMALL_LENS = Intrinsics(focal_length_px=(190.0, 230.0), image_size_px=(96, 90))
SHEET = Pattern.cross_grid(rows=3, columns=3, pitch_mm=22.0, radius_mm=7.0)


def camera_of(lens: Intrinsics = SMALL_LENS, pan_deg: float = 25.0, tilt_deg: float = 40.0):
    return Camera.from_degrees(
        lens, pan_deg=pan_deg, tilt_deg=tilt_deg, swing_deg=3.0, distance_mm=300.0
    )
