"""Pictures of a chessboard that is held before cameras which are known, still or while it moves."""

from collections.abc import Sequence

import cv2
import numpy as np

from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.squares import dark_squares
from trinoc.geometry.rotation import rotation_from_vector

SIZE_PX = (480, 360)
BOARD = Chessboard(rows=5, columns=7, square_mm=20.0)
FOCAL_PX = {"left": 520.0, "right": 540.0}
# Finer than a pixel by this, before the light of each is summed.
_FINE, _PX_PER_MM = 3, 4.0
_PAPER, _INK, _WALL = 215.0, 35.0, 120.0


def matrix(camera: str) -> np.ndarray:
    """(3, 4) of a camera, in the frame of the left one: the right one stands aside, turned in."""
    middle = (np.array(SIZE_PX) - 1.0) / 2.0
    intrinsics = np.diag([FOCAL_PX[camera], FOCAL_PX[camera], 1.0])
    intrinsics[:2, 2] = middle
    angle, aside_mm = {"left": (0.0, 0.0), "right": (0.3, 150.0)}[camera]
    rotation = np.asarray(rotation_from_vector(np.array([0.0, angle, 0.0])))
    return intrinsics @ np.column_stack([rotation, rotation @ [-aside_mm, 0.0, 0.0]])


def hold_board(
    place_mm: Sequence[float], turn_deg: Sequence[float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """(3, 4) a board whose middle is at a place before the left camera, turned about its axes."""
    turn = np.asarray(rotation_from_vector(np.radians(np.asarray(turn_deg, dtype=float))))
    rotation = turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.append(BOARD.centres_mm.mean(axis=0), 0.0)
    return np.column_stack([rotation, np.asarray(place_mm) - rotation @ middle])


def _sheet() -> tuple[np.ndarray, np.ndarray]:
    """(the print with its white margin, the homography from its pixels to millimetres)."""
    side = round(BOARD.square_mm * _PX_PER_MM)
    squares = dark_squares(BOARD.rows + 1, BOARD.columns + 1)
    ink = np.pad(np.kron(squares, np.ones((side, side))), side // 2)
    # Row 0 of the squares is the upper one; Y points up.
    left, upper = BOARD.centres_mm.min(axis=0)[0], BOARD.centres_mm.max(axis=0)[1]
    first = 1.5 * BOARD.square_mm
    to_mm = np.array(
        [[1 / _PX_PER_MM, 0, left - first], [0, -1 / _PX_PER_MM, upper + first], [0, 0, 1.0]]
    )
    return np.where(ink > 0, _INK, _PAPER).astype(np.float32), to_mm


def board_picture(camera: str, poses: Sequence[np.ndarray], seed: int = 0) -> np.ndarray:
    """What a camera sees of a board that takes these poses, (3, 4) each, while it looks."""
    sheet, to_mm = _sheet()
    finer = np.diag([_FINE, _FINE, 1.0])
    finer[:2, 2] = (_FINE - 1) / 2
    size = (_FINE * SIZE_PX[0], _FINE * SIZE_PX[1])
    light = np.zeros(size[::-1], np.float32)
    for pose in poses:
        motion = np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])
        homography = finer @ (matrix(camera) @ motion)[:, [0, 1, 3]] @ to_mm
        light += cv2.warpPerspective(sheet, homography, size, borderValue=_WALL) / len(poses)
    light = cv2.GaussianBlur(light, (0, 0), 0.6 * _FINE)
    picture = cv2.resize(light, SIZE_PX, interpolation=cv2.INTER_AREA)
    noise = np.random.default_rng(seed).normal(0.0, 1.0, picture.shape)
    return np.clip(np.round(picture + noise), 0, 255).astype(np.uint8)


def move_poses(pose: np.ndarray, by_mm: Sequence[float], steps: int = 9) -> list[np.ndarray]:
    """The poses of a board that moves by so much while the camera looks, past the one given."""
    shares = np.linspace(-0.5, 0.5, steps)
    return [np.column_stack([pose[:, :3], pose[:, 3] + s * np.asarray(by_mm)]) for s in shares]
