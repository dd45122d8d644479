"""Rigs whose truth is known: Table 1 of the 1986 paper, and random ones like it."""

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig

# pan, tilt, swing in degrees and distance in mm: Yokoi, Medioni and Nevatia (1986), Table 1.
TABLE_1 = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "left": (-23.241, 38.264, 0.872, 474.471),
    "right": (23.568, 38.616, -0.994, 472.894),
}
FOCAL_LENGTH_MM = 16.0
PIXEL_PITCH_MM = (0.0162, 0.0134)
IMAGE_SIZE_PX = (512, 480)


def table1_lens(*, resolution: int = 1, distortion: tuple[float, ...] | None = None) -> Intrinsics:
    """The paper's lens and sensor, 512 x 480 pixels that are not square.

    `resolution` divides each pixel into that many along both sides and leaves the field of
    view as it is. `distortion` is up to five Brown-Conrady coefficients.
    """
    return Intrinsics(
        focal_length_mm=FOCAL_LENGTH_MM,
        pixel_pitch_mm=(PIXEL_PITCH_MM[0] / resolution, PIXEL_PITCH_MM[1] / resolution),
        image_size_px=(IMAGE_SIZE_PX[0] * resolution, IMAGE_SIZE_PX[1] * resolution),
        distortion=distortion,
    )


def table1_rig(*, resolution: int = 1, distortion: tuple[float, ...] | None = None) -> Rig:
    """The cameras "upper", "left" and "right" of Table 1; see `table1_lens` for the options."""
    lens = table1_lens(resolution=resolution, distortion=distortion)
    return Rig({name: _camera(lens, row) for name, row in TABLE_1.items()})


def random_rig(seed: int, *, wide: bool = False, lens: Intrinsics | None = None) -> Rig:
    """Three cameras about the origin, drawn by `seed`.

    Near Table 1 each angle is within 8 degrees of the paper's and the distance within 10 %;
    a wide rig has pans within 60, tilts from 20 to 80 and swings within 15 degrees, and
    distances from 400 to 600 mm. `lens` defaults to `table1_lens()`.
    """
    lens = table1_lens() if lens is None else lens
    generator = np.random.default_rng(seed)
    if wide:
        low, high = (-60.0, 20.0, -15.0, 400.0), (60.0, 80.0, 15.0, 600.0)
        rows = {name: generator.uniform(low, high) for name in TABLE_1}
    else:
        rows = {}
        for name, row in TABLE_1.items():
            angles = np.array(row[:3]) + generator.uniform(-8.0, 8.0, 3)
            rows[name] = np.append(angles, row[3] * generator.uniform(0.9, 1.1))
    return Rig({name: _camera(lens, row) for name, row in rows.items()})


def _camera(lens: Intrinsics, row: np.ndarray | tuple[float, float, float, float]) -> Camera:
    pan, tilt, swing, distance = (float(value) for value in row)
    return Camera.from_degrees(
        lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
    )
