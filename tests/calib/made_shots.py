"""Simulated shots of a board by known cameras, with seeded noise."""

from typing import Any

import jax
import numpy as np

from trinoc.calib import Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry import AbstractLens
from trinoc.geometry.lenses.polynomial import BrownConrady
from trinoc.geometry.rotation import rotation_from_vector

SIZE_PX = (640, 480)
BOARD = Chessboard(rows=5, columns=6, square_mm=25.0)
SIGMA_PX = 0.05
LENSES = {
    "left": np.array([800.0, 805.0, 322.0, 236.0, -0.20, 0.06, 0.001, -0.0005, 0.0]),
    "middle": np.array([780.0, 782.0, 315.0, 243.0, -0.15, 0.03, 0.0, 0.001, 0.0]),
    "right": np.array([820.0, 818.0, 326.0, 240.0, -0.18, 0.05, -0.001, 0.0, 0.0]),
}
# Turned about y and moved along x, from the middle camera.
PLACES = {"left": (-0.35, 220.0), "middle": (0.0, 0.0), "right": (0.35, -220.0)}


def chained(second: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Matrix (4, 4) of the motion `first` followed by `second`."""
    last = [[0.0, 0.0, 0.0, 1.0]]
    return (np.vstack([second, last]) @ np.vstack([first, last]))[:3]


def inverse(motion: np.ndarray) -> np.ndarray:
    return np.linalg.inv(np.vstack([motion, [[0.0, 0.0, 0.0, 1.0]]]))[:3]


def lens_of(name: str) -> AbstractLens:
    return BrownConrady.from_parameters(LENSES[name])


def cam_from_rig(name: str) -> np.ndarray:
    angle, shift = PLACES[name]
    rotation = np.asarray(rotation_from_vector(np.array([0.0, angle, 0.0])))
    return np.column_stack(
        [rotation, rotation @ np.array([shift, 0.0, 0.0]) + [0, 0, 40 * abs(angle)]]
    )


def board_poses(count: int, seed: int = 0, tilt_deg: float = 40.0) -> np.ndarray:
    """Random poses of a hand-held board in front of the middle camera."""
    random = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        about = random.uniform(0, 2 * np.pi)
        tilt = np.radians(random.uniform(0.4, 1.0) * tilt_deg)
        turn = tilt * np.array([np.cos(about), np.sin(about), 0.0])
        roll = np.asarray(rotation_from_vector(np.array([0.0, 0.0, random.uniform(-0.3, 0.3)])))
        facing = np.diag([1.0, -1.0, -1.0])
        rotation = np.asarray(rotation_from_vector(turn)) @ roll @ facing
        position_mm = [*random.uniform(-50, 50, 2), random.uniform(520, 700)]
        poses.append(np.column_stack([rotation, position_mm]))
    return np.stack(poses)


@jax.jit
def _pixels(lens, cam, board, points_mm):
    def pixel(point_mm):
        in_rig = board[:, :3] @ point_mm + board[:, 3]
        return lens.project_ray(cam[:, :3] @ in_rig + cam[:, 3])

    return jax.vmap(pixel)(points_mm)


def detection(
    name: str,
    board_pose: np.ndarray,
    random: np.random.Generator,
    target: AbstractTarget = BOARD,
    sigma_px: float = SIGMA_PX,
    aside_mm: np.ndarray | None = None,
) -> Detection:
    """Detection of the corners inside the image by a perfect detector with this noise.

    aside_mm : displacement of each corner on the board.
    """
    corners_mm = np.pad(target.centres_mm, ((0, 0), (0, 1)))
    corners_mm = corners_mm if aside_mm is None else corners_mm + aside_mm
    exact = np.asarray(_pixels(lens_of(name), cam_from_rig(name), board_pose, corners_mm))
    inside = ((exact > 2) & (exact < np.array(SIZE_PX) - 3)).all(axis=1)
    count = int(inside.sum())
    return Detection(
        circle_index=np.flatnonzero(inside),
        centres_px=exact[inside] + random.normal(0, sigma_px, (count, 2)),
        covariance_px2=np.broadcast_to(sigma_px**2 * np.eye(2), (count, 2, 2)).copy(),
        shape_px2=np.full((count, 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=SIZE_PX,
    )


def shots(
    seed: int = 1,
    count: int = 7,
    cameras: tuple[str, ...] = tuple(LENSES),
    aside_mm: np.ndarray | None = None,
    **poses,
) -> dict[str, list[Any]]:
    random = np.random.default_rng(seed)
    boards = board_poses(count, **poses)
    return {
        name: [detection(name, board, random, aside_mm=aside_mm) for board in boards]
        for name in cameras
    }
