"""Simulated detections of a sheet by known cameras: exact ellipse centres plus seeded noise."""

import jax
import numpy as np
from jaxtyping import Float

from trinoc.calib import Detection
from trinoc.calib.targets.pattern import Pattern
from trinoc.calib.uncertainty.systematics import Systematics
from trinoc.geometry.camera import Camera
from trinoc.geometry.image_of_circle import image_of_circle_centre
from trinoc.geometry.intrinsics import Intrinsics
from trinoc.numerics.precision import ArrayLike

# Made pictures are of what is said of them.
EXACT = Systematics()
LENS = Intrinsics(focal_length_mm=16, pixel_pitch_mm=(0.0162, 0.0134), image_size_px=(512, 480))
DISTORTED_LENS = Intrinsics(
    focal_length_mm=16,
    pixel_pitch_mm=(0.0162, 0.0134),
    image_size_px=(512, 480),
    distortion=(-0.12, 0.03, 0.002, -0.001, 0.01),
)
# Pan, tilt, swing in degrees and distance in mm of the paper's Table 1.
TABLE_1 = {
    "upper": (2.143, 53.252, -1.714, 476.369),
    "right": (23.568, 38.616, -0.994, 472.894),
    "left": (-23.241, 38.264, 0.872, 474.471),
}
SIGMA_PX = 0.005


def reference_sheet() -> Pattern:
    """Sheet of 5 x 5 circles of 6 mm radius at 20 mm, with lines that stop at the circles."""
    return Pattern.cross_grid(rows=5, columns=5, pitch_mm=20.0, radius_mm=6.0, rings="none")


def camera_of(
    values: tuple[float, ...], lens: Intrinsics = LENS, aim_mm: tuple[float, float] = (0.0, 0.0)
) -> Camera:
    pan, tilt, swing, distance = values
    return Camera.from_degrees(
        lens, pan_deg=pan, tilt_deg=tilt, swing_deg=swing, distance_mm=distance, aim_mm=aim_mm
    )


@jax.jit
def _ellipse_centres(
    camera: Camera, centres_mm: Float[jax.Array, "n 2"], radius_mm: Float[jax.Array, "n"]
) -> Float[ArrayLike, "n 2"]:
    return jax.vmap(image_of_circle_centre, in_axes=(None, 0, 0))(camera, centres_mm, radius_mm)


def simulated_detection(
    camera: Camera,
    pattern: Pattern,
    *,
    seed: int,
    sigma_px: float = SIGMA_PX,
    circles: np.ndarray | None = None,
    lines_seen: bool = True,
) -> Detection:
    """Detection of `circles` (indices; all by default) by a perfect detector with noise."""
    index = np.arange(len(pattern)) if circles is None else np.asarray(circles)
    exact = np.asarray(
        _ellipse_centres(camera, pattern.centres_mm[index], pattern.radius_mm[index])
    )
    noise = np.random.default_rng(seed).normal(0.0, sigma_px, exact.shape)
    matrix = camera.matrix_px
    along_x, along_y = np.diag([1.0, 1.0, 1.0, 1.0])[:2]
    origin = matrix[:, 3]
    lines = np.stack([np.cross(matrix @ along_x, origin), np.cross(matrix @ along_y, origin)])
    lines /= np.linalg.norm(lines[:, :2], axis=1, keepdims=True)
    count = len(index)
    return Detection(
        circle_index=index,
        centres_px=exact + noise,
        covariance_px2=np.broadcast_to(sigma_px**2 * np.eye(2), (count, 2, 2)).copy(),
        shape_px2=np.broadcast_to(100.0 * np.eye(2), (count, 2, 2)).copy(),
        lines_px=lines if lines_seen else np.full((2, 3), np.nan),
        image_size_px=camera.image_size_px,
    )
