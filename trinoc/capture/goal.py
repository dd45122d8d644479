"""Goal for the next image of the board: a sentence, and the positions to draw."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MIDDLE = (0.5, 0.5)
# numerical: foreshortening of a board that is tilted by 30 degrees.
_FORESHORTENED = 0.87
# Largest pitch, as a share of the image, at which a whole board reaches the outermost cells of the
# field, whose middles lie at 1/16 and at 1/12.
_WIDEST_PITCH = (0.058, 0.077)
# Margin around the outer points, in pitches: their squares or circles, plus a little.
_OUTSIDE = 1.05


class Goal(NamedTuple):
    """Wanted position and tilt of the board in the next image.

    Attributes
    ----------
    sentence : str
        Instruction for the user.
    middle : (2,)
        Position of the board's middle, in shares of the image's width and height.
    fill : float
        Share of the image's width or height that the board fills. It is smaller if the whole board
        would not fit in the image.
    lean : (2,)
        Tilt, as in `measure_lean`.
    turn_deg : float
        Rotation about the optical axis, clockwise in the image.
    """

    sentence: str
    middle: tuple[float, float] = MIDDLE
    fill: float = 0.7
    lean: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


def goal_points_px(
    goal: Goal, points_mm: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Float[np.ndarray, "m 2"]:
    """Positions of the board's points in an image that meets the goal, (m, 2) px.

    `points_mm` (m, 2) are on the board, Y up. The result is a sketch of the whole board, without a
    lens model.
    """
    extent = np.maximum(np.ptp(points_mm, axis=0), 1e-9)
    centred_mm = (points_mm - 0.5 * (points_mm.min(axis=0) + points_mm.max(axis=0))) * (1.0, -1.0)
    lean = np.array(goal.lean)
    depth = 1.0 + (centred_mm / extent) @ lean
    shape = centred_mm * np.where(lean != 0.0, _FORESHORTENED, 1.0) / depth[:, None]
    sine, cosine = np.sin(np.radians(goal.turn_deg)), np.cos(np.radians(goal.turn_deg))
    shape = shape @ np.array([[cosine, sine], [-sine, cosine]])
    size, box, pitch = np.array(size_px), np.ptp(shape, axis=0), _pitch_mm(points_mm)
    around = box + 2.0 * _OUTSIDE * pitch
    scale = min(goal.fill * float(np.max(size / box)), float(np.min(size / around)))
    if goal.middle != MIDDLE:
        scale = min(scale, float(np.min(size * _WIDEST_PITCH)) / pitch)
    half = 0.5 * scale * around
    middle = np.clip(np.array(goal.middle) * size, half, size - half) - 0.5
    return middle + scale * (shape - 0.5 * (shape.min(axis=0) + shape.max(axis=0)))


def goal_outline_px(
    goal: Goal, points_mm: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Float[np.ndarray, "4 2"]:
    """Corners of the rectangle around the board's points, (4, 2) px, in the goal position."""
    corners_mm = outline_mm(points_mm)
    return goal_points_px(goal, np.concatenate([points_mm, corners_mm]), size_px)[-4:]


def outline_mm(points_mm: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "4 2"]:
    """Corners of the rectangle around the board's points, (4, 2) mm, upper left first."""
    (left, lower), (right, upper) = points_mm.min(axis=0), points_mm.max(axis=0)
    return np.array([[left, upper], [right, upper], [right, lower], [left, lower]])


def _pitch_mm(points_mm: Float[np.ndarray, "m 2"]) -> float:
    """Smallest distance between two points."""
    distance_mm = np.linalg.norm(points_mm[:, None] - points_mm[None], axis=2)
    return (
        float(np.min(distance_mm[distance_mm > 0], initial=np.inf))
        if (distance_mm > 0).any()
        else 1.0
    )
