"""Image qualities and pictures of a board with known places, blur and light."""

import cv2
import numpy as np
from scipy.special import erf

from trinoc.capture.image_quality import ImageQuality
from trinoc.capture.measures import Exposure
from trinoc.geometry.camera import Camera
from trinoc.geometry.intrinsics import Intrinsics

SIZE_PX = (320, 240)
GRID_MM = np.stack(np.meshgrid(np.linspace(-40, 40, 5), np.linspace(-40, 40, 5)), -1).reshape(-1, 2)


def quality(points_px: np.ndarray, lean: tuple[float, float] = (0.0, 0.0), **other: object):
    """A good image quality with the fields of `other` replaced."""
    good = ImageQuality(
        name="made.png",
        size_px=SIZE_PX,
        points_px=points_px,
        points_mm=GRID_MM[: len(points_px)],
        point_count=len(GRID_MM),
        kind="circles",
        refusal="",
        blur_px=1.0,
        exposure=Exposure(0.0, 0.0, 0.8),
        lean=lean,
        faults=(),
    )
    return good._replace(**other)


def rectangle(left: float, upper: float, right: float, lower: float) -> np.ndarray:
    """Grid of positions in a part of the image, px. The arguments are fractions of its sides."""
    u, v = np.meshgrid(np.linspace(left, right, 5), np.linspace(upper, lower, 5))
    return np.stack([u, v], axis=-1).reshape(-1, 2) * SIZE_PX - 0.5


def camera(pan_deg: float, tilt_deg: float) -> Camera:
    lens = Intrinsics(focal_length_px=(400.0, 400.0), image_size_px=SIZE_PX)
    return Camera.from_degrees(
        lens, pan_deg=pan_deg, tilt_deg=tilt_deg, swing_deg=0.0, distance_mm=300.0
    )


def step_picture(blur_px: float, contrast: float, noise: float, turn_deg: float) -> np.ndarray:
    """Grey bars with an exact blur: a step blurred by a Gaussian is its error function."""
    v, u = np.mgrid[:160, :200].astype(float)
    angle = np.deg2rad(turn_deg)
    across = (np.cos(angle) * u + np.sin(angle) * v) % 64 - 32
    # A rising and a falling edge in each period.
    level = np.minimum(
        erf((across + 16) / np.sqrt(2) / blur_px), erf((16 - across) / np.sqrt(2) / blur_px)
    )
    rng = np.random.default_rng(1)
    return (128 + contrast / 2 * level + rng.normal(0, noise, level.shape)).astype(np.float32)


def circles_picture(camera: Camera) -> np.ndarray:
    """An image of the grid's points as dots, for display."""
    picture = np.full(SIZE_PX[::-1], 220, dtype=np.uint8)
    for point_mm in GRID_MM:
        u, v = np.asarray(camera.project(np.append(point_mm, 0.0)))
        cv2.circle(picture, (round(u), round(v)), 3, 30, -1)
    return picture
