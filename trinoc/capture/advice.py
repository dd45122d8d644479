"""What the pictures so far show together, and what the next should show."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from trinoc.capture.judgement import Judgement
from trinoc.capture.measures import GRID, cover_cells

# Share of the field's cells that good pictures together cover when it is enough.
ENOUGH_FIELD = 0.9
# A board leans when one side is farther away than the other by this share of the distance: with a
# normal lens and a board that fills half the picture, about 20 degrees.
LEAN = 0.08
FEWEST_PICTURES = 6
# Which side of the picture is the far one: along which axis, with which sign.
_SIDES = (("right", 0, 1), ("left", 0, -1), ("upper", 1, -1), ("lower", 1, 1))
# The ninths of the picture, row by row.
_NINTHS = (
    *("the upper left corner", "the upper edge", "the upper right corner"),
    *("the left edge", "the middle", "the right edge"),
    *("the lower left corner", "the lower edge", "the lower right corner"),
)


def field(judgements: Sequence[Judgement]) -> Bool[np.ndarray, "r c"]:
    """Cells of the field that the good pictures cover together."""
    cells = np.zeros(GRID, dtype=bool)
    for judgement in judgements:
        if judgement.good:
            cells |= cover_cells(judgement.places_px, judgement.size_px)
    return cells


def field_share(judgements: Sequence[Judgement]) -> float:
    """The share of the field that the good pictures cover, 0 to 1."""
    return float(field(judgements).mean())


def next_step(judgements: Sequence[Judgement]) -> str:
    """One sentence: what to do next. What is wrong with the last picture comes first."""
    if not judgements:
        return "Hold the board square to the camera, in the middle of the picture."
    last = judgements[-1]
    if not last.found:
        return "Take it again: " + last.refusal
    if last.faults:
        return f"Take it again: {last.faults[0]}."
    cells = field(judgements)
    if cells.mean() < ENOUGH_FIELD:
        return f"Move the board to {_emptiest(cells)} of the picture."
    missing = _missing_sides(judgements)
    if missing:
        return f"Tilt the board, its {missing[0]} side farther away, filling half the picture."
    good = sum(judgement.good for judgement in judgements)
    if good < FEWEST_PICTURES:
        return f"Take {FEWEST_PICTURES - good} more, turned and tilted otherwise."
    return "Enough: the field is covered and the board was tilted to all sides."


def shows_something_new(earlier: Sequence[Judgement], last: Judgement) -> bool:
    """Whether a good picture covers a new cell of the field, or leans to a side not seen yet."""
    after = [*earlier, last]
    if not last.good or field(after).sum() > field(earlier).sum():
        return last.good
    return len(_missing_sides(after)) < len(_missing_sides(earlier))


def summary_lines(judgements: Sequence[Judgement]) -> list[str]:
    """How many pictures are good, what they cover, and what to do next."""
    good = sum(judgement.good for judgement in judgements)
    lost = sum(not judgement.found for judgement in judgements)
    counts = f"{len(judgements)} pictures: {good} good, {lost} without the board found, "
    counts += f"{len(judgements) - good - lost} to take again"
    return [f"{counts}; {field_share(judgements):.0%} of the field covered.", next_step(judgements)]


def _emptiest(cells: Bool[np.ndarray, "r c"]) -> str:
    """The ninth of the field that is covered least, in words."""
    bands = [np.array_split(band, 3, axis=1) for band in np.array_split(cells, 3)]
    shares = [ninth.mean() for band in bands for ninth in band]
    # The middle decides least of what a lens does: among equals it comes last.
    return _NINTHS[min(range(9), key=lambda k: (shares[k], _NINTHS[k] == "the middle"))]


def _missing_sides(judgements: Sequence[Judgement]) -> list[str]:
    """The sides that were never the far one."""
    leans = np.array([judgement.lean for judgement in judgements if judgement.good])
    return [side for side, axis, sign in _SIDES if not (sign * leans[:, axis] > LEAN).any()]
