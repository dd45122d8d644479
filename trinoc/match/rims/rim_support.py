"""Which chords speak for which circles, looked at in parts for memory; and whether two views show
another circle as well in place of one: then neither is known.
"""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array

from trinoc.match.rims.circles import (
    MIDDLE,
    ON_ARC,
    Chords,
    Circles,
    Off,
    image_circles,
    off_circles,
    touching,
)
from trinoc.match.tuning.rims import RimTuning
from trinoc.numerics.buckets import blocks
from trinoc.numerics.tables import take_rows

# numerical: chords that are held against circles at once, some 800 bytes each.
MOST_AT_ONCE = 1 << 16
# numerical: circles whose centres share a cell of so many radii are looked at together.
_CELL_RADII = 2.0


def supports(chords: Chords, circles: Circles, within_px: float, tuning: RimTuning) -> csr_array:
    """(h, s) Support of all chords for all circles, of which few touch; neighbours are held
    against what is about them."""
    shape = len(circles.radius_mm), len(chords.view)
    entries = [(np.zeros(0), (np.zeros(0, np.int64), np.zeros(0, np.int64)))]
    cell = _CELL_RADII * np.median(circles.radius_mm) if shape[0] else 1.0
    order = np.lexsort(np.floor(circles.centre_mm / cell).T)
    for part in blocks(shape[0], max(MOST_AT_ONCE // max(shape[1], 1), 1)):
        some = take_rows(circles, order[part])
        near = np.flatnonzero(about(chords, some, within_px).any(axis=0))
        own = take_rows(chords, near)
        found = sum_support(own, off_circles(own, some), within_px, tuning)
        row, column = np.nonzero(found)
        entries.append((found[row, column], (order[part][row], near[column])))
    values = np.concatenate([value for value, _ in entries])
    index = np.concatenate([np.stack(places) for _, places in entries], axis=1)
    return coo_array((values, (index[0], index[1])), shape=shape).tocsr()


def sum_support(
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
        image = image_circles(circles, chords.matrix_px[own[0]])
        off = chords.places_px[own, MIDDLE] - image.middle_px[:, None]
        # In perspective, the image reaches further on the side that is nearer.
        reach = 1.5 * image.axes_px[:, :1] + margin_px
        found[:, own] = (off**2).sum(axis=2) < reach**2
    return found


# numerical: the inverse depth of what is looked for, in units of the circle's own.
_NEAREST, _MOST_STEPS = 3.0, 2000


def has_rival(
    chords: Chords, circle: Circles, own: Int[np.ndarray, "k"], tuning: RimTuning
) -> bool:
    """Whether the chords of one of two views lie on another circle, too, with others of the second.

    Circles moved toward a camera or away from it, their planes parallel, have one image there. So
    an arc of one view may go with any arc of the second that such a circle meets.
    """
    one, other = np.unique(chords.view[own]).tolist()
    return any(
        _has_other_chords(chords, circle, own, first, second, tuning)
        for first, second in ((one, other), (other, one))
    )


def _has_other_chords(
    chords: Chords,
    circle: Circles,
    own: Int[np.ndarray, "k"],
    first: int,
    second: int,
    tuning: RimTuning,
) -> bool:
    """Whether the second view shows a circle of the same image in the first by other chords, half
    as long."""
    there = chords.view == second
    rows = np.setdiff1d(np.flatnonzero(there), own)
    if len(rows) == 0:
        return False
    eye = chords.centre_mm[(chords.view == first).argmax()]
    moved = _of_one_image(circle, eye, chords.matrix_px[there.argmax()], tuning)
    others = take_rows(chords, rows)
    longest = (supports(others, moved, 2 * tuning.touch_px, tuning) > 0) @ others.length_px
    return bool(longest.max() > 0.5 * chords.length_px[own[there[own]]].sum())


def _of_one_image(
    circle: Circles,
    eye_mm: Float[np.ndarray, "3"],
    other_px: Float[np.ndarray, "3 4"],
    tuning: RimTuning,
) -> Circles:
    """The circles with this one's image from `eye_mm`, a step in the other view apart."""
    way = circle.centre_mm[0] - eye_mm
    here = other_px @ np.append(circle.centre_mm[0], 1.0)
    afar = other_px[:, :3] @ way
    # From what is far away to here; where it leaves the view sideways, as many steps as allowed.
    path = np.linalg.norm(here[:2] / here[2] - afar[:2] / max(afar[2], 1e-9 * abs(here[2])))
    steps = int(np.clip(_NEAREST * path / (2 * tuning.touch_px), 1, _MOST_STEPS))
    larger = steps / (_NEAREST * np.arange(1, steps + 1))
    return Circles(
        eye_mm + larger[:, None] * way,
        np.tile(circle.normal, (steps, 1)),
        larger * circle.radius_mm,
    )
