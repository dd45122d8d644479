"""What the pictures so far show together, and what the next should show."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from trinoc.capture.goal import Goal
from trinoc.capture.judgement import Judgement
from trinoc.capture.measures import GRID, cover_cells

# Share of the field's cells that good pictures together cover when it is enough.
ENOUGH_FIELD = 0.9
# A board leans when one side is farther away than the other by this share of the distance: with a
# normal lens and a board that fills half the picture, about 20 degrees.
LEAN = 0.08
FEWEST_PICTURES = 6
# What is asked for, so that what comes of it is surely a lean.
_LEANING = 0.2
ENOUGH = "Enough: the field is covered and the board was tilted to all sides."
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


def next_goal(judgements: Sequence[Judgement]) -> Goal | None:
    """How the board is wanted next, by what good pictures show; None when these are enough."""
    good = [judgement for judgement in judgements if judgement.good]
    if not good:
        return Goal("Hold the board square to the camera, in the middle of the picture.")
    cells = field(good)
    if cells.mean() < ENOUGH_FIELD:
        ninth, middle = _emptiest(cells)
        return Goal(f"Move the board to {ninth} of the picture.", middle, fill=0.45)
    missing = _missing_sides(good)
    if missing:
        side, axis, sign = missing[0]
        lean = (sign * _LEANING, 0.0) if axis == 0 else (0.0, sign * _LEANING)
        return Goal(
            f"Tilt the board, its {side} side farther away, filling half the picture.", lean=lean
        )
    if len(good) < FEWEST_PICTURES:
        more = FEWEST_PICTURES - len(good)
        said = f"Take {more} more, turned and tilted otherwise."
        return Goal(said, lean=(_LEANING, _LEANING), turn_deg=20.0 * more)
    return None


def next_step(judgements: Sequence[Judgement]) -> str:
    """One sentence: what to do next. What is wrong with the last picture comes first."""
    last = judgements[-1] if judgements else None
    if last is not None and not last.found:
        return "Take it again: " + last.refusal
    if last is not None and last.faults:
        return f"Take it again: {last.faults[0]}."
    goal = next_goal(judgements)
    return ENOUGH if goal is None else goal.sentence


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


def _emptiest(cells: Bool[np.ndarray, "r c"]) -> tuple[str, tuple[float, float]]:
    """The ninth of the field that is covered least, in words, and the middle of a cell in it that
    is not covered, in shares of the picture's sides."""
    bands = [
        np.array_split(band, 3, axis=1)
        for band in np.array_split(np.arange(cells.size).reshape(cells.shape), 3)
    ]
    ninths = [ninth.ravel() for band in bands for ninth in band]
    shares = [cells.flat[ninth].mean() for ninth in ninths]
    # The middle decides least of what a lens does: among equals it comes last.
    least = min(range(9), key=lambda k: (shares[k], _NINTHS[k] == "the middle"))
    empty = ninths[least][~cells.flat[ninths[least]]]
    row, column = np.divmod(empty, cells.shape[1])
    middles = (np.stack([column, row], axis=1) + 0.5) / cells.shape[::-1]
    nearest = np.argmin(np.linalg.norm(middles - middles.mean(axis=0), axis=1))
    across, down = middles[nearest].tolist()
    return _NINTHS[least], (across, down)


def _missing_sides(judgements: Sequence[Judgement]) -> list[tuple[str, int, int]]:
    """The rows of `_SIDES` whose side was never the far one."""
    leans = np.array([judgement.lean for judgement in judgements if judgement.good]).reshape(-1, 2)
    return [row for row in _SIDES if not (row[2] * leans[:, row[1]] > LEAN).any()]
