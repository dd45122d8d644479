"""Ways to hold the board before a rig that anybody can follow."""

from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from trinoc.calib.problem.problem import Problem, lens_number
from trinoc.calib.targets import AbstractTarget, board_names, boards_of
from trinoc.geometry import AbstractLens, Pose, unproject_pixels

_TILT_RAD = np.radians(40.0)
# The side of the board that comes nearer, by a turn about the camera's x and y.
_TURNS = {
    "square to it": (0.0, 0.0),
    "tilted by 40 degrees, its left side toward the camera": (0.0, -1.0),
    "tilted by 40 degrees, its right side toward the camera": (0.0, 1.0),
    "tilted by 40 degrees, its upper side toward the camera": (1.0, 0.0),
    "tilted by 40 degrees, its lower side toward the camera": (-1.0, 0.0),
}
# Shares of the picture's shorter side that the board takes, and shares of the picture left around
# it where it is held aside.
_FILLS, _MARGIN = (0.35, 0.6), 0.05
_ROWS, _COLUMNS = ("top", "middle", "bottom"), ("left", "middle", "right")


class Candidate(NamedTuple):
    """A shot that could be taken: before which camera the board is held and how, in words."""

    camera: int
    words: str
    distance_mm: float
    rig_from_board: Pose


def candidate_shots(problem: Problem) -> list[Candidate]:
    """The board in nine places of every camera's picture, at two distances, tilted or not."""
    members, names = boards_of(problem.target), board_names(problem.target)
    set_from_board = [Pose(each) for each in np.asarray(problem.state.set_from_board)]
    shots = []
    for camera, size_px in problem.image_sizes_px.items():
        lens = lens_number(problem, int(problem.chart.lens_of_camera[camera]))
        rig_from_cam = Pose(np.asarray(problem.state.cam_from_rig)[camera]).inverse
        for fill, (number, board) in product(_FILLS, enumerate(members)):
            which = f'"{names[number]}" ' if len(members) > 1 else ""
            distance = _distance_mm(board, lens, fill * min(size_px))
            share = np.array([0.5 * fill + _MARGIN, 0.5, 1.0 - 0.5 * fill - _MARGIN])
            down, across = (grid.ravel() for grid in np.meshgrid(range(3), range(3)))
            at = np.stack([share[across], share[down]], axis=1) * (np.array(size_px) - 1.0)
            for row, column, ray in zip(down, across, unproject_pixels(lens, at), strict=True):
                place = which + _place_words(_ROWS[row], _COLUMNS[column])
                for words, about in _TURNS.items():
                    pose = rig_from_cam @ _hold(board, ray, distance, about)
                    if len(members) > 1:
                        pose @= set_from_board[number].inverse
                    shots.append(Candidate(camera, f"{place}, {words}", distance, pose))
    return shots


def _distance_mm(target: AbstractTarget, lens: AbstractLens, side_px: float) -> float:
    """The distance at which the board's longer side takes so many pixels."""
    extent = np.max(np.ptp(target.centres_mm, axis=0) + 2.0 * np.max(target.radius_mm))
    return float(np.max(lens.focal_length_px) * extent / side_px)


def _hold(
    target: AbstractTarget,
    ray: Float[np.ndarray, "3"],
    distance_mm: float,
    about: tuple[float, float],
) -> Pose:
    """The board before a camera, its middle on a ray along which it faces it, and then turned."""
    axis = np.cross([0.0, 0.0, 1.0], ray)
    sine = float(np.linalg.norm(axis))
    aim = cv2.Rodrigues(axis / max(sine, 1e-12) * np.arctan2(sine, ray[2]))[0]
    turn = cv2.Rodrigues(_TILT_RAD * np.append(about, 0.0))[0]
    rotation = aim @ turn @ np.diag([1.0, -1.0, -1.0])
    middle = np.append(0.5 * (target.centres_mm.min(axis=0) + target.centres_mm.max(axis=0)), 0.0)
    return Pose(np.column_stack([rotation, distance_mm * ray - rotation @ middle]))


def _place_words(row: str, column: str) -> str:
    if row == column:
        return "in the middle of its picture"
    if "middle" in (row, column):
        return f"at the {column if row == 'middle' else row} of its picture"
    return f"in the {row} {column} corner of its picture"
