"""Whether two views show another circle as well in place of one: then neither is known."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.match.rims.circles import Chords, Circles
from trinoc.match.rims.support import supports
from trinoc.match.tuning import RimTuning
from trinoc.numerics import take_rows

# The inverse depth of what is looked for, in units of the circle's own.
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
        _shown_elsewhere(chords, circle, own, first, second, tuning)
        for first, second in ((one, other), (other, one))
    )


def _shown_elsewhere(
    chords: Chords,
    circle: Circles,
    own: Int[np.ndarray, "k"],
    first: int,
    second: int,
    tuning: RimTuning,
) -> bool:
    """Whether the second view shows a circle of the same image in the first by other chords."""
    there = chords.view == second
    rows = np.setdiff1d(np.flatnonzero(there), own)
    if len(rows) == 0:
        return False
    eye = chords.centre_mm[(chords.view == first).argmax()]
    moved = _of_one_image(circle, eye, chords.matrix_px[there.argmax()], tuning)
    others = take_rows(chords, rows)
    longest = (supports(others, moved, tuning.first_px, tuning) > 0) @ others.length_px
    return bool(longest.max() > tuning.rival_share * chords.length_px[own[there[own]]].sum())


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
    steps = int(np.clip(_NEAREST * path / tuning.first_px, 1, _MOST_STEPS))
    larger = steps / (_NEAREST * np.arange(1, steps + 1))
    return Circles(
        eye_mm + larger[:, None] * way,
        np.tile(circle.normal, (steps, 1)),
        larger * circle.radius_mm,
    )
