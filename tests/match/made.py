"""Small made scenes: loose lines before the rig of the method's Table 1."""

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.match.matches import Matches

POSES = {
    "upper": {"pan_deg": 2.143, "tilt_deg": 53.252, "swing_deg": -1.714, "distance_mm": 476.369},
    "right": {"pan_deg": 23.568, "tilt_deg": 38.616, "swing_deg": -0.994, "distance_mm": 472.894},
    "left": {"pan_deg": -23.241, "tilt_deg": 38.264, "swing_deg": 0.872, "distance_mm": 474.471},
    "low": {"pan_deg": 5.0, "tilt_deg": 25.0, "swing_deg": 0.5, "distance_mm": 475.0},
    "east": {"pan_deg": 40.0, "tilt_deg": 50.0, "swing_deg": 0.0, "distance_mm": 480.0},
}


def rig_of(*names: str, distortion: tuple[float, ...] | None = None) -> Rig:
    lens = Intrinsics(
        focal_length_mm=16.0,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=distortion,
    )
    return Rig({name: Camera.from_degrees(lens, **POSES[name]) for name in names})


def loose_lines(count: int, seed: int) -> np.ndarray:
    """(count, 2, 3) lines of 15 to 40 mm in all directions above the sheet."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-50, -45, 0], [50, 45, 40], (count, 3))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    half = rng.uniform(7.5, 20, (count, 1)) * direction
    return np.stack([middle - half, middle + half], axis=1)


def pictures(rig: Rig, lines_mm: np.ndarray, sigma_px: float = 0.0, seed: int = 0) -> dict:
    """Camera names to (n, 2, 2) images of all lines, in the order of the lines."""
    rng = np.random.default_rng(seed)
    seen = {}
    for name, matrix in zip(rig.names, rig.matrices_px, strict=True):
        image = lines_mm @ matrix[:, :3].T + matrix[:, 3]
        seen[name] = image[..., :2] / image[..., 2:]
        seen[name] = seen[name] + sigma_px * rng.normal(size=seen[name].shape)
    return seen


def as_set(matches: Matches, views: tuple[str, ...]) -> set[tuple[int, ...]]:
    """The segments of every track, in the order of `views`."""
    order = [matches.views.index(view) for view in views]
    return {tuple(row) for row in matches.index[:, order].tolist()}
