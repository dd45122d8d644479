"""Pictures of boards before known cameras, at rest or moving."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from trinoc.calib.targets.abstract_target import AbstractBoard, Polygon
from trinoc.calib.targets.checkers import Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.geometry.rotation import rotation_from_vector

SIZE_PX = (480, 360)
SHEET = Pattern.cross_grid(rows=6, columns=6, pitch_mm=20.0, radius_mm=7.5)
CHESSBOARD = Chessboard(rows=5, columns=7, square_mm=20.0)
FOCAL_PX = {"left": 520.0, "right": 540.0}
# Finer than a pixel by this, before the light of each is summed.
_FINE, _PX_PER_MM, _MARGIN_MM, _SHIFT = 3, 5.0, 20.0, 6
_PAPER, _INK, _WALL = 215.0, 35.0, 120.0


def matrix(camera: str) -> np.ndarray:
    """Camera matrix (3, 4) in the frame of the left camera. The right camera is turned inwards."""
    middle = (np.array(SIZE_PX) - 1.0) / 2.0
    intrinsics = np.diag([FOCAL_PX[camera], FOCAL_PX[camera], 1.0])
    intrinsics[:2, 2] = middle
    angle, aside_mm = {"left": (0.0, 0.0), "right": (0.17, 150.0)}[camera]
    rotation = np.asarray(rotation_from_vector(np.array([0.0, angle, 0.0])))
    return intrinsics @ np.column_stack([rotation, rotation @ [-aside_mm, 0.0, 0.0]])


def hold_board(
    place_mm: ArrayLike, turn_deg: ArrayLike = (0.0, 0.0, 0.0), board: AbstractBoard = SHEET
) -> np.ndarray:
    """Pose (3, 4) of a board with its centre before the left camera, turned about its axes."""
    turn = np.asarray(rotation_from_vector(np.radians(np.asarray(turn_deg, dtype=float))))
    rotation = turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.append(board.centres_mm.mean(axis=0), 0.0)
    return np.column_stack([rotation, np.asarray(place_mm) - rotation @ middle])


def _draw_sheet(board: AbstractBoard) -> tuple[np.ndarray, np.ndarray]:
    """The printed sheet with a white margin, and the homography from its pixels to millimetres."""
    low, high = board.centres_mm.min(axis=0) - _MARGIN_MM, board.centres_mm.max(axis=0) + _MARGIN_MM
    width, height = np.ceil((high - low) * _PX_PER_MM).astype(int)
    to_mm = np.array([[1 / _PX_PER_MM, 0, low[0]], [0, -1 / _PX_PER_MM, high[1]], [0, 0, 1.0]])
    sheet = np.full((height, width), _PAPER, np.float32)

    def fixed_point(positions_mm: ArrayLike) -> np.ndarray:
        positions_px = (np.asarray(positions_mm) - (low[0], high[1])) * (_PX_PER_MM, -_PX_PER_MM)
        return np.round(positions_px * 2**_SHIFT).astype(np.int32)

    for part in board.drawing():
        level = _INK if part.is_ink else _PAPER
        if isinstance(part, Polygon):
            corners = fixed_point(part.corners_mm)
            cv2.fillConvexPoly(sheet, corners, level, cv2.LINE_8, _SHIFT)
        else:
            radius = round(part.radius_mm * _PX_PER_MM * 2**_SHIFT)
            centre = fixed_point(part.centre_mm).tolist()
            cv2.circle(sheet, centre, radius, level, -1, cv2.LINE_8, _SHIFT)
    return sheet, to_mm


def board_picture(
    camera: str, poses: Sequence[np.ndarray], seed: int = 0, board: AbstractBoard = SHEET
) -> np.ndarray:
    """The image of a board that takes these poses, (3, 4) each, during one exposure."""
    sheet, to_mm = _draw_sheet(board)
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


def move_poses(pose: np.ndarray, by_mm: ArrayLike, steps: int = 9) -> list[np.ndarray]:
    """Poses of a board that moves past a given pose during one exposure."""
    shares = np.linspace(-0.5, 0.5, steps)
    return [np.column_stack([pose[:, :3], pose[:, 3] + s * np.asarray(by_mm)]) for s in shares]
