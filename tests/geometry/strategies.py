"""Hypothesis strategies for cameras, points and rigs of a plausible bench."""

import numpy as np
from hypothesis import strategies as st

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics

LENS = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480))
DISTORTED_LENS = Intrinsics(
    focal_length_mm=16,
    pixel_pitch_mm=(0.0162, 0.0134),
    image_size_px=(512, 480),
    distortion=(-0.12, 0.03, 0.002, -0.001, 0.01),
)


def real(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def vectors(size: int, reach: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(real(-reach, reach), min_size=size, max_size=size).map(np.array)


@st.composite
def cameras(draw: st.DrawFn, lens: Intrinsics = LENS) -> Camera:
    """A camera around the sheet, as on a bench."""
    return Camera.from_degrees(
        lens,
        pan_deg=draw(real(-170, 170)),
        tilt_deg=draw(real(15, 80)),
        swing_deg=draw(real(-170, 170)),
        distance_mm=draw(real(250, 900)),
        aim_mm=(draw(real(-40, 40)), draw(real(-40, 40))),
    )


def points_near_sheet() -> st.SearchStrategy[np.ndarray]:
    """Points in front of every camera that `cameras` draws."""
    return vectors(3, 60.0)


@st.composite
def rigs_of_three(draw: st.DrawFn) -> list[Camera]:
    """Three cameras, at least 20 degrees of pan from each other: every pair has a baseline."""
    pans = [draw(real(-60, -30)), draw(real(-8, 8)), draw(real(30, 60))]
    return [
        Camera.from_degrees(
            LENS,
            pan_deg=pan,
            tilt_deg=draw(real(25, 65)),
            swing_deg=draw(real(-20, 20)),
            distance_mm=draw(real(350, 600)),
        )
        for pan in pans
    ]
