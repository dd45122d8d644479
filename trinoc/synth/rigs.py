"""Rigs with known parameters: Table 1 of Yokoi, Medioni and Nevatia (1986), and random ones."""

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
    """Return the lens and sensor of Yokoi et al. (1986): 512 x 480 pixels that are not square.

    Parameters
    ----------
    resolution : int
        Each pixel is divided into this many pixels along both sides. The field of view does not
        change.
    distortion : tuple of float, optional
        Up to five Brown-Conrady coefficients.

    Returns
    -------
    Intrinsics
    """
    return Intrinsics(
        focal_length_mm=FOCAL_LENGTH_MM,
        pixel_pitch_mm=(PIXEL_PITCH_MM[0] / resolution, PIXEL_PITCH_MM[1] / resolution),
        image_size_px=(IMAGE_SIZE_PX[0] * resolution, IMAGE_SIZE_PX[1] * resolution),
        distortion=distortion,
    )


def table1_rig(*, resolution: int = 1, distortion: tuple[float, ...] | None = None) -> Rig:
    """Return the cameras "upper", "left" and "right" of Table 1 of Yokoi et al. (1986).

    Parameters
    ----------
    resolution, distortion :
        As in `table1_lens`.

    Returns
    -------
    Rig
    """
    lens = table1_lens(resolution=resolution, distortion=distortion)
    return Rig({name: _camera(lens, row) for name, row in TABLE_1.items()})


def random_rig(seed: int, *, wide: bool = False, lens: Intrinsics | None = None) -> Rig:
    """Return three random cameras that look at the origin.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    wide : bool
        False: each angle differs by at most 8 degrees from `table1_rig`, each distance by at most
        10 %. True: pan from -60 to 60 degrees, tilt from 20 to 80, swing from -15 to 15,
        distances from 400 to 600 mm.
    lens : Intrinsics, optional
        Lens of all cameras. Default: `table1_lens()`.

    Returns
    -------
    Rig
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
