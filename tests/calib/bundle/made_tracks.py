"""Simulated lines around the reference rig, observed by its cameras with noise of known size."""

import numpy as np

from trinoc.geometry import LineObservations
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.geometry.rig import Rig
from trinoc.geometry.segments import covariance_of_ends

ANGLES_AND_DISTANCES = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "right": (23.568, 38.616, -0.994, 472.894),
    "left": (-23.241, 38.264, 0.872, 474.471),
}
PARAMETERS = ("pan_deg", "tilt_deg", "swing_deg", "distance_mm")
NAMES = tuple(f"{camera}.{name}" for camera in ANGLES_AND_DISTANCES for name in PARAMETERS)
TRUTH = np.array([value for values in ANGLES_AND_DISTANCES.values() for value in values])
SHEET_SIGMA = np.tile([0.02, 0.02, 0.02, 0.1], 3)


def rig_at(values: np.ndarray, *, with_covariance: bool) -> Rig:
    """The reference rig with other values of its twelve parameters."""
    lens = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480))
    cameras = {
        name: Camera.from_degrees(lens, **dict(zip(PARAMETERS, row, strict=True)))
        for name, row in zip(ANGLES_AND_DISTANCES, values.reshape(3, 4).tolist(), strict=True)
    }
    if not with_covariance:
        return Rig(cameras)
    return Rig(cameras, parameters=NAMES, covariance=np.diag(SHEET_SIGMA**2))


def made_tracks(
    seed: int, tracks: int, *, sigma_px: float = 0.3, wrong: float = 0.0, hidden: float = 0.2
) -> tuple[LineObservations, np.ndarray, np.ndarray]:
    """Simulated lines seen by Table 1's rig: observations, true ends (t, 2, 3), wrong mask (t,)."""
    random = np.random.default_rng(seed)
    middle = random.uniform(-70, 70, (tracks, 3))
    middle[:, 2] = abs(middle[:, 2])
    direction = random.standard_normal((tracks, 3))
    direction *= 20 / np.linalg.norm(direction, axis=1, keepdims=True)
    ends = np.stack([middle - direction, middle + direction], axis=1)
    matrices = rig_at(TRUTH, with_covariance=False).matrices_px
    homogeneous = np.concatenate([ends, np.ones((tracks, 2, 1))], axis=2)
    image = np.einsum("vij,tej->tvei", matrices, homogeneous)
    exact = image[..., :2] / image[..., 2:]
    covariance = np.stack(
        [covariance_of_ends(exact[:, v], sigma_px, 5 * sigma_px) for v in range(3)], axis=1
    )
    noise = np.einsum(
        "tvij,tvj->tvi", np.linalg.cholesky(covariance), random.standard_normal((tracks, 3, 4))
    )
    fragments = exact + noise.reshape(tracks, 3, 2, 2)
    visible = np.ones((tracks, 3), dtype=bool)
    partly = np.flatnonzero(random.random(tracks) < hidden)
    visible[partly, random.integers(0, 3, len(partly))] = False
    bad = visible.all(axis=1) & (random.random(tracks) < wrong)
    fragments[bad, random.integers(0, 3, bad.sum())] += random.normal(0, 15, (bad.sum(), 2, 2))
    fragments[~visible] = np.nan
    start = ends + random.normal(0, 0.5, ends.shape)
    views = tuple(ANGLES_AND_DISTANCES)
    return LineObservations(views, fragments, covariance, visible, start), ends, bad
