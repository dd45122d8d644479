"""Colours that people with any colour vision tell apart, and which track gets which.

The palette is that of M. Okabe and K. Ito, "Color Universal Design" (2008), without its
yellow, which is lost on a light page.
"""

import numpy as np
from jaxtyping import Float, Int

BLUE, VERMILION, GREEN = "#0072b2", "#d55e00", "#009e73"
PURPLE, ORANGE, SKY, BLACK = "#b8478f", "#e69f00", "#3a9bdc", "#222222"
# What stands in space, by the role of its layer.
COLOUR_OF_ROLE = {
    "three": BLUE,
    "two": VERMILION,
    "cameras": GREEN,
    "sheet": "#777777",
    "ellipsoids": PURPLE,
}
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY, BLACK)


def distinct_neighbours(
    midpoints_px: Float[np.ndarray, "t v 2"], colours: int = len(PALETTE)
) -> Int[np.ndarray, "t"]:
    """A colour number per track, so that tracks near each other in a picture differ.

    Tracks take, one after the other, the colour whose earlier tracks are farthest from them;
    `midpoints_px` is NaN where a view does not see a track.
    """
    chosen = np.zeros(len(midpoints_px), dtype=np.int64)
    for track in range(1, len(midpoints_px)):
        squared = np.sum((midpoints_px[:track] - midpoints_px[track]) ** 2, axis=-1)
        nearness = np.max(np.nan_to_num(1.0 / (squared + 1.0)), axis=-1)
        crowding = np.bincount(chosen[:track], weights=nearness, minlength=colours)
        chosen[track] = int(np.argmin(crowding))
    return chosen
