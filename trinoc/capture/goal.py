"""How the board is wanted next in a camera's picture, as words and as places to draw."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

MIDDLE = (0.5, 0.5)
# numerical: what a board that is turned by 30 degrees away from the camera keeps of a side.
_FORESHORTENED = 0.87
# Of the picture: at most so much between two places lets a board that must be seen whole reach
# the outermost cells of the field, whose middles lie at 1/16 and at 1/12.
_WIDEST_PITCH = (0.058, 0.077)
# Around the outer places, in pitches: their squares or circles, and a little.
_OUTSIDE = 1.05


class Goal(NamedTuple):
    """How the board is wanted next.

    Fields
    ------
    sentence : in words.
    middle : where its middle is to be, (across, down) in shares of the picture's sides.
    fill : of a side of the picture, that it takes, where that leaves it whole.
    lean : as `measure_lean` has it.
    turn_deg : about the camera's axis, clockwise in the picture.
    """

    sentence: str
    middle: tuple[float, float] = MIDDLE
    fill: float = 0.7
    lean: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0


def hold_places(
    goal: Goal, places_mm: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Float[np.ndarray, "m 2"]:
    """Where the places of a board lie in the picture of one who holds it as is wanted.

    places_mm : on the board, Y up. It is seen whole, and needs no lens: a sketch to aim at.
    """
    extent = np.maximum(np.ptp(places_mm, axis=0), 1e-9)
    flat = (places_mm - 0.5 * (places_mm.min(axis=0) + places_mm.max(axis=0))) * (1.0, -1.0)
    lean = np.array(goal.lean)
    depth = 1.0 + (flat / extent) @ lean
    shape = flat * np.where(lean != 0.0, _FORESHORTENED, 1.0) / depth[:, None]
    sine, cosine = np.sin(np.radians(goal.turn_deg)), np.cos(np.radians(goal.turn_deg))
    shape = shape @ np.array([[cosine, sine], [-sine, cosine]])
    size, box, pitch = np.array(size_px), np.ptp(shape, axis=0), _pitch_mm(places_mm)
    around = box + 2.0 * _OUTSIDE * pitch
    scale = min(goal.fill * float(np.max(size / box)), float(np.min(size / around)))
    if goal.middle != MIDDLE:
        scale = min(scale, float(np.min(size * _WIDEST_PITCH)) / pitch)
    half = 0.5 * scale * around
    middle = np.clip(np.array(goal.middle) * size, half, size - half) - 0.5
    return middle + scale * (shape - 0.5 * (shape.min(axis=0) + shape.max(axis=0)))


def hold_outline(
    goal: Goal, places_mm: Float[np.ndarray, "m 2"], size_px: tuple[int, int]
) -> Float[np.ndarray, "4 2"]:
    """The corners of the rectangle around the places, as `hold_places` has them."""
    corners_mm = outline_mm(places_mm)
    return hold_places(goal, np.concatenate([places_mm, corners_mm]), size_px)[-4:]


def outline_mm(places_mm: Float[np.ndarray, "m 2"]) -> Float[np.ndarray, "4 2"]:
    """The corners of the rectangle around the places of a board, the upper left one first."""
    (left, lower), (right, upper) = places_mm.min(axis=0), places_mm.max(axis=0)
    return np.array([[left, upper], [right, upper], [right, lower], [left, lower]])


def _pitch_mm(places_mm: Float[np.ndarray, "m 2"]) -> float:
    """The least distance between two places."""
    apart = np.linalg.norm(places_mm[:, None] - places_mm[None], axis=2)
    return float(np.min(apart[apart > 0], initial=np.inf)) if (apart > 0).any() else 1.0
