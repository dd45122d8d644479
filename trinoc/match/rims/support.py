"""Which chords speak for which circles, looked at in parts for memory."""

import numpy as np
from jaxtyping import Bool, Float
from scipy.sparse import coo_array, csr_array

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
MOST_AT_ONCE = 1 << 16
# Circles whose centres share a cell of so many radii are looked at together.
_CELL_RADII = 2.0


def supports(chords: Chords, circles: Circles, within_px: float, tuning: RimTuning) -> csr_array:
    """(h, s) `support_of` all chords for all circles, of which few touch; neighbours are held
    against what is about them."""
    shape = len(circles.radius_mm), len(chords.view)
    entries = [(np.zeros(0), (np.zeros(0, np.int64), np.zeros(0, np.int64)))]
    cell = _CELL_RADII * np.median(circles.radius_mm) if shape[0] else 1.0
    order = np.lexsort(np.floor(circles.centre_mm / cell).T)
    for part in blocks(shape[0], max(MOST_AT_ONCE // max(shape[1], 1), 1)):
        some = take_rows(circles, order[part])
        near = np.flatnonzero(about(chords, some, within_px).any(axis=0))
        own = take_rows(chords, near)
        found = support_of(own, off_circles(own, some), within_px, tuning)
        row, column = np.nonzero(found)
        entries.append((found[row, column], (order[part][row], near[column])))
    values = np.concatenate([value for value, _ in entries])
    index = np.concatenate([np.stack(places) for _, places in entries], axis=1)
    return coo_array((values, (index[0], index[1])), shape=shape).tocsr()


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
