"""Small synthetic scenes: loose lines in front of the rig of the method's Table 1."""

import numpy as np

from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.match.tracks.matches import BINOCULAR, TRINOCULAR, Matches
from trinoc.match.tracks.reliability import scene_extent_mm

# Pan, tilt and swing in degrees, distance in mm.
POSES = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "right": (23.568, 38.616, -0.994, 472.894),
    "left": (-23.241, 38.264, 0.872, 474.471),
    "low": (5.0, 25.0, 0.5, 475.0),
    "east": (40.0, 50.0, 0.0, 480.0),
}


def rig_of(
    *names: str,
    distortion: tuple[float, ...] | None = None,
    **poses: tuple[float, float, float, float],
) -> Rig:
    """Rig of cameras of POSES by name, and of others by pan, tilt, swing and distance."""
    lens = Intrinsics(
        focal_length_mm=16.0,
        pixel_pitch_mm=(0.0162, 0.0134),
        image_size_px=(512, 480),
        distortion=distortion,
    )
    cameras = {}
    for name, pose in ({name: POSES[name] for name in names} | poses).items():
        pan, tilt, swing, distance = pose
        cameras[name] = Camera.from_degrees(
            lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance
        )
    return Rig(cameras)


def loose_lines(count: int, seed: int) -> np.ndarray:
    """(count, 2, 3) lines of 15 to 40 mm in all directions above the sheet."""
    rng = np.random.default_rng(seed)
    middle = rng.uniform([-50, -45, 0], [50, 45, 40], (count, 3))
    direction = rng.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    half = rng.uniform(7.5, 20, (count, 1)) * direction
    return np.stack([middle - half, middle + half], axis=1)


def pictures(rig: Rig, lines_mm: np.ndarray, sigma_px: float = 0.0, seed: int = 0) -> dict:
    """Images of all lines (n, 2, 2) by camera name, in the order of the lines."""
    rng = np.random.default_rng(seed)
    pictures_px = {}
    for name, matrix in zip(rig.names, rig.matrices_px, strict=True):
        image = lines_mm @ matrix[:, :3].T + matrix[:, 3]
        pictures_px[name] = image[..., :2] / image[..., 2:]
        pictures_px[name] = pictures_px[name] + sigma_px * rng.normal(size=pictures_px[name].shape)
    return pictures_px


def as_set(matches: Matches, views: tuple[str, ...]) -> set[tuple[int, ...]]:
    """The segments of every track, in the order of `views`."""
    order = [matches.views.index(view) for view in views]
    return {tuple(row) for row in matches.index[:, order].tolist()}


def sure_matches(
    sigma_share: float = 0.002, count: int = 40, views: tuple[str, ...] = ("upper", "left", "right")
) -> Matches:
    """Sure matches in all views whose sigma across is this share of the scene's extent."""
    random = np.random.default_rng(count)
    lines = random.uniform(-100, 100, (count, 2, 3))
    sigma = sigma_share * scene_extent_mm(lines)
    index = np.tile(np.arange(count)[:, None], (1, len(views)))
    # Ends with independent errors leave half the variance to the midpoint.
    return Matches(
        views=views,
        index=index,
        fragments_px=random.uniform(0, 500, (count, len(views), 2, 2)),
        lines_mm=lines,
        covariance_mm2=np.tile(2 * sigma**2 * np.eye(6), (count, 1, 1)),
        stage=np.full(count, TRINOCULAR if len(views) > 2 else BINOCULAR),
        posterior=np.full(count, 0.99),
        rival_posterior=np.zeros(count),
        reasons={view: np.full(count, "matched") for view in views},
        counts={},
    )
