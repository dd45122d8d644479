"""Simulated shots of boards fixed to each other, by known cameras, with seeded noise."""

import numpy as np

from tests.calib.made_shots import LENSES, SIZE_PX, _pixels, chained, inverse, lens_of
from trinoc.calib import BoardSet, Detection
from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Chessboard
from trinoc.geometry.rotation import rotation_from_vector

SIGMA_PX = 0.05
FRONT = Chessboard(rows=5, columns=7, square_mm=22.0)
BACK = AprilGrid(rows=3, columns=3, tag_mm=36.0, spacing=0.3, name="back")
SIDE = Chessboard(rows=4, columns=6, square_mm=25.0)
# A block that a person holds: the back looks the other way, the side to the right.
IN_SET = {
    "front": np.eye(3, 4),
    "back": np.column_stack([np.diag([-1.0, 1.0, -1.0]), [6.0, -4.0, -60.0]]),
    "side": np.column_stack(
        [np.asarray(rotation_from_vector(np.array([0.05, 0.9, 0.0]))), [140.0, 5.0, -50.0]]
    ),
}
BOARDS: dict[str, AbstractTarget] = {"front": FRONT, "back": BACK, "side": SIDE}


def turned(about_y: float, x: float, z: float) -> np.ndarray:
    """cam_from_rig of a camera at (x, 0, z), turned about y."""
    rotation = np.asarray(rotation_from_vector(np.array([0.0, about_y, 0.0])))
    return np.column_stack([rotation, -rotation @ np.array([x, 0.0, z])])


# Two beside each other, and two that look at the first from the other side.
CAMERAS = {
    "left": turned(0.0, 0.0, 0.0),
    "right": turned(0.3, 200.0, 30.0),
    "far": turned(np.pi, 30.0, 1260.0),
}
LENS_OF = dict(zip(CAMERAS, LENSES, strict=True))


def poses_of_set(count: int, seed: int = 0) -> np.ndarray:
    """rig_from_set of each shot: the front faces the left camera, tilted and rolled at random."""
    random, poses = np.random.default_rng(seed), []
    for _ in range(count):
        about, tilt = random.uniform(0, 2 * np.pi), random.uniform(0.25, 0.75)
        turn = np.asarray(
            rotation_from_vector(tilt * np.array([np.cos(about), np.sin(about), 0.0]))
        )
        roll = np.asarray(rotation_from_vector(np.array([0.0, 0.0, random.uniform(-0.5, 0.5)])))
        rotation = turn @ roll @ np.diag([1.0, -1.0, -1.0])
        position_mm = [*random.uniform(-50, 50, 2), random.uniform(560, 700)]
        poses.append(np.column_stack([rotation, position_mm]))
    return np.stack(poses)


def detect_boards(
    camera: str, rig_from_set: np.ndarray, boards: tuple[str, ...], random: np.random.Generator
) -> Detection | None:
    """Detection of all boards of a set that face the camera and lie in its image."""
    index, pixels, first = [], [], 0
    for name in boards:
        board = BOARDS[name]
        pose = chained(rig_from_set, IN_SET[name])
        in_camera = chained(CAMERAS[camera], pose)
        points_mm = np.pad(board.centres_mm, ((0, 0), (0, 1)))
        exact = np.asarray(_pixels(lens_of(LENS_OF[camera]), CAMERAS[camera], pose, points_mm))
        inside = ((exact > 2) & (exact < np.array(SIZE_PX) - 3)).all(axis=1)
        faces = in_camera[:, 2] @ in_camera[:, 3] < -0.35 * np.linalg.norm(in_camera[:, 3])
        if faces and inside.mean() > (0.99 if isinstance(board, Chessboard) else 0.6):
            index.append(first + np.flatnonzero(inside))
            pixels.append(exact[inside])
        first += len(board)
    if not index:
        return None
    count = sum(len(each) for each in index)
    return Detection(
        circle_index=np.concatenate(index),
        centres_px=np.concatenate(pixels) + random.normal(0, SIGMA_PX, (count, 2)),
        covariance_px2=np.broadcast_to(SIGMA_PX**2 * np.eye(2), (count, 2, 2)).copy(),
        shape_px2=np.full((count, 2, 2), np.nan),
        lines_px=np.full((2, 3), np.nan),
        image_size_px=SIZE_PX,
    )


def set_of(boards: tuple[str, ...]) -> BoardSet:
    return BoardSet({name: BOARDS[name] for name in boards})


def set_shots(
    boards: tuple[str, ...],
    cameras: tuple[str, ...],
    *,
    seed: int = 1,
    count: int = 10,
    pose_seed: int = 0,
) -> dict[str, list[Detection | None]]:
    """Detections of each camera in each shot."""
    random, poses = np.random.default_rng(seed), poses_of_set(count, pose_seed)
    return {
        camera: [detect_boards(camera, pose, boards, random) for pose in poses]
        for camera in cameras
    }


def fixed(first: str, second: str) -> np.ndarray:
    """True first_from_second of two boards of the block."""
    return chained(inverse(IN_SET[first]), IN_SET[second])
