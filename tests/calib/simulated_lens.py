"""Simulated detections through a known lens, by OpenCV's projection.

They use no code of the fitted model. The centre of a circle's image is the centroid of the
polygon of its projected boundary.
"""

import cv2
import numpy as np

from trinoc.calib import Detection
from trinoc.calib.result.calibration import CalibrationResult
from trinoc.calib.targets.pattern import Pattern

SHEET = Pattern.cross_grid(rows=6, columns=6, pitch_mm=25.0, radius_mm=8.0)
SIZE_PX = (512, 480)
# fx, fy, cx, cy, k1, k2, p1, p2, k3
LENS = np.array([987.65, 1194.03, 250.0, 243.0, -0.2, 0.15, 0.001, -0.0005, -0.05])
SIGMA_PX = 0.005
FACING = np.diag([1.0, -1.0, -1.0])
_ANGLES = np.linspace(0, 2 * np.pi, 200, endpoint=False)


def pose(
    *,
    tilt_deg: float,
    azimuth_deg: float,
    roll_deg: float = 0.0,
    distance_mm: float = 470.0,
    aside: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """cam_from_world (3, 4): the sheet rolled, then tilted about an axis of the picture."""
    azimuth = np.radians(azimuth_deg)
    axis = np.radians(tilt_deg) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    roll = cv2.Rodrigues(np.array([0.0, 0.0, np.radians(roll_deg)]))[0]
    translation = distance_mm * np.array([*aside, 1.0])
    return np.column_stack([cv2.Rodrigues(axis)[0] @ roll @ FACING, translation])


def good_poses(seed: int = 0, count: int = 8) -> list[np.ndarray]:
    generator = np.random.default_rng(seed)
    return [
        pose(
            tilt_deg=generator.uniform(15, 50),
            azimuth_deg=360 * (k + generator.uniform()) / count,
            roll_deg=generator.uniform(-30, 30),
            distance_mm=generator.uniform(400, 560),
            aside=tuple(generator.uniform(-0.05, 0.05, 2)),
        )
        for k in range(count)
    ]


def centres_px(
    cam_from_world: np.ndarray, values: np.ndarray = LENS, sheet: Pattern = SHEET
) -> np.ndarray:
    boundary = boundaries_px(cam_from_world, values, sheet)
    start = boundary.mean(axis=1, keepdims=True)
    one, two = boundary - start, np.roll(boundary, -1, axis=1) - start
    area = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    moment = np.sum((one + two) * area[..., None], axis=1)
    return start[:, 0] + moment / (3 * area.sum(axis=1)[:, None])


def boundaries_px(
    cam_from_world: np.ndarray, values: np.ndarray = LENS, sheet: Pattern = SHEET
) -> np.ndarray:
    ring = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)
    plane = sheet.centres_mm[:, None] + sheet.radius_mm[:, None, None] * ring[None]
    points = np.concatenate([plane, np.zeros_like(plane[..., :1])], axis=2).reshape(-1, 3)
    matrix = np.array([[values[0], 0, values[2]], [0, values[1], values[3]], [0, 0, 1]])
    turn = cv2.Rodrigues(cam_from_world[:, :3])[0]
    uv = cv2.projectPoints(points, turn, cam_from_world[:, 3], matrix, values[4:])[0]
    return uv.reshape(len(sheet), -1, 2)


def detection(
    cam_from_world: np.ndarray,
    *,
    seed: int = 0,
    sigma_px: float = SIGMA_PX,
    values: np.ndarray = LENS,
    sheet: Pattern = SHEET,
) -> Detection:
    """Detection of the circles that lie in the image, by a perfect detector with noise."""
    noise = np.random.default_rng(seed).normal(0.0, sigma_px, (len(sheet), 2))
    uv_px = centres_px(cam_from_world, values, sheet) + noise
    index = np.flatnonzero(((uv_px > 10) & (uv_px < np.array(SIZE_PX) - 11)).all(axis=1))
    reported_sigma_px = max(sigma_px, 1e-3)
    return Detection(
        circle_index=index,
        centres_px=uv_px[index],
        covariance_px2=np.tile(reported_sigma_px**2 * np.eye(2), (len(index), 1, 1)),
        shape_px2=np.tile(100.0 * np.eye(2), (len(index), 1, 1)),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=SIZE_PX,
    )


def detections(poses: list[np.ndarray], seed: int = 0, **options) -> list[Detection]:
    return [detection(each, seed=1000 * seed + k, **options) for k, each in enumerate(poses)]


def lens_values(result: CalibrationResult) -> np.ndarray:
    """Parameters of the only lens, in their order."""
    return np.array([result.value(name) for name in result.lens_parameters])


def lens_sigmas(result: CalibrationResult) -> np.ndarray:
    """Standard deviations of the parameters of the only lens."""
    return np.array([result.sigma(name) for name in result.lens_parameters])


def fitted_names(result: CalibrationResult) -> tuple[str, ...]:
    """Names of the estimated parameters of the only lens."""
    return tuple(name for name in result.lens_parameters if result.sigma(name) != 0.0)


def squared_distance(result: CalibrationResult, truth: np.ndarray) -> float:
    """Squared Mahalanobis distance of the only lens's fitted parameters from the truth."""
    names = result.lens_parameters
    rows = [names.index(name) for name in fitted_names(result)]
    error = (lens_values(result) - truth)[rows]
    return float(error @ np.linalg.solve(result.lens_covariance[np.ix_(rows, rows)], error))
