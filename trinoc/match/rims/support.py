"""Which chords speak for which circles, looked at in parts for memory."""

import numpy as np
from jaxtyping import Bool, Float

from trinoc.match.rims.circles import (
    MIDDLE,
    ON_ARC,
    Chords,
    Circles,
    Off,
    images_of,
    off_circles,
    touching,
)
from trinoc.match.tuning import RimTuning
from trinoc.numerics import blocks, take_rows

# Chords that are held against circles at once, some 800 bytes each.
MOST_AT_ONCE = 1 << 18
# Circles whose centres share a cell of so many radii are looked at together.
_CELL_RADII = 8.0


def supports(
    chords: Chords, circles: Circles, within_px: float, tuning: RimTuning
) -> Float[np.ndarray, "h s"]:
    """`support_of` all chords for all circles; neighbours are held against what is about them."""
    found = np.zeros((len(circles.radius_mm), len(chords.view)))
    cell = _CELL_RADII * np.median(circles.radius_mm) if len(found) else 1.0
    order = np.lexsort(np.floor(circles.centre_mm / cell).T)
    for part in blocks(len(order), max(MOST_AT_ONCE // max(len(chords.view), 1), 1)):
        rows = order[part]
        some = take_rows(circles, rows)
        near = np.flatnonzero(about(chords, some, within_px).any(axis=0))
        own = take_rows(chords, near)
        found[np.ix_(rows, near)] = support_of(own, off_circles(own, some), within_px, tuning)
    return found


def support_of(
    chords: Chords, off: Off, within_px: float, tuning: RimTuning
) -> Float[np.ndarray, "h s"]:
    """Length of the chords that touch circles; those that lie near count for more, so that of the
    circles about one rim the truest comes first."""
    apart = np.abs(off.px[..., ON_ARC]).max(axis=2) / within_px
    weight = np.sqrt(np.clip(1 - apart, 0.0, 1.0)) * chords.length_px
    return np.where(touching(off, within_px, tuning), weight, 0.0)


def about(chords: Chords, circles: Circles, margin_px: float) -> Bool[np.ndarray, "h s"]:
    """Whether chords have their middles within circles' images, or this near to them."""
    found = np.zeros((len(circles.radius_mm), len(chords.view)), dtype=bool)
    for view in np.unique(chords.view):
        own = np.flatnonzero(chords.view == view)
        image = images_of(circles, chords.matrix_px[own[0]])
        off = chords.places_px[own, MIDDLE] - image.middle_px[:, None]
        # In perspective, the image reaches further on the side that is nearer.
        reach = 1.5 * image.axes_px[:, :1] + margin_px
        found[:, own] = (off**2).sum(axis=2) < reach**2
    return found
