"""Words beside lines on a picture, none upon another."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from trinoc.report.pictures import Window

# In 1/512 of the picture's width: height of a word, width of a letter, distance from its line.
HEIGHT, LETTER, AWAY = 15.0, 9.0, 12.0
# Where along its line a word may stand, the best place first.
PLACES = (0.5, 0.3, 0.7, 0.15, 0.85)


class PlacedLabel(NamedTuple):
    """A word and the place of its middle, in pixels of the picture."""

    u: float
    v: float
    text: str


def place_labels(
    texts: Sequence[str], lines_px: Float[np.ndarray, "n 2 2"], window: Window
) -> list[PlacedLabel]:
    """A place beside each line where no earlier word stands; words that find none are left out."""
    taken: list[tuple[float, float, float, float]] = []
    placed = []
    for text, (first, second) in zip(texts, lines_px, strict=True):
        along = second - first
        length = float(np.hypot(*along))
        across = np.array([-along[1], along[0]]) / (length + 1e-9) * AWAY * window.unit
        half = np.array([len(text) * LETTER, HEIGHT]) * window.unit / 2
        for share, side in ((share, side) for share in PLACES for side in (1, -1)):
            middle = first + share * along + side * across
            low, high = middle - half, middle + half
            box = (*low.tolist(), *high.tolist())
            if _inside(box, window) and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                placed.append(PlacedLabel(float(middle[0]), float(middle[1]), text))
                break
    return placed


def _inside(box: tuple[float, float, float, float], window: Window) -> bool:
    left, top, right, bottom = box
    return (
        left >= window.left
        and top >= window.top
        and right <= window.left + window.width
        and bottom <= window.top + window.height
    )


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
