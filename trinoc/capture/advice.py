"""Coverage by all images so far, and the goal for the next image."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool

from trinoc.capture.goal import Goal
from trinoc.capture.image_quality import ImageQuality
from trinoc.capture.measures import GRID, cover_cells

# Share of the field's cells that good images must cover.
ENOUGH_FIELD = 0.9
# Smallest difference in distance of two sides of a tilted board, as a share of the distance. With a
# normal lens and a board that fills half the image, about 20 degrees.
LEAN = 0.08
FEWEST_PICTURES = 6
# Lean of the goals, with a margin above LEAN.
_LEANING = 0.2
ENOUGH = "Enough: the field is covered and the board was tilted to all sides."
# Far side of the board: name, image axis, sign of the lean.
_SIDES = (("right", 0, 1), ("left", 0, -1), ("upper", 1, -1), ("lower", 1, 1))
# Ninths of the image, row by row.
_NINTHS = (
    *("the upper left corner", "the upper edge", "the upper right corner"),
    *("the left edge", "the middle", "the right edge"),
    *("the lower left corner", "the lower edge", "the lower right corner"),
)


def covered_cells(qualities: Sequence[ImageQuality]) -> Bool[np.ndarray, "r c"]:
    """Mask (r, c) of the cells of the camera's field in which a good image shows the board."""
    cells = np.zeros(GRID, dtype=bool)
    for quality in qualities:
        if quality.is_good:
            cells |= cover_cells(quality.points_px, quality.size_px)
    return cells


def field_share(qualities: Sequence[ImageQuality]) -> float:
    """Share of the field that the good images cover, 0 to 1."""
    return float(covered_cells(qualities).mean())


def next_goal(qualities: Sequence[ImageQuality]) -> Goal | None:
    """Wanted position and tilt of the board in the next image; None if the good images suffice."""
    good = [quality for quality in qualities if quality.is_good]
    if not good:
        return Goal("Hold the board square to the camera, in the middle of the picture.")
    cells = covered_cells(good)
    if cells.mean() < ENOUGH_FIELD:
        ninth, middle = _emptiest(cells)
        return Goal(f"Move the board to {ninth} of the picture.", middle, fill=0.45)
    missing = _missing_sides(good)
    if missing:
        side, axis, sign = missing[0]
        lean = (sign * _LEANING, 0.0) if axis == 0 else (0.0, sign * _LEANING)
        return Goal(
            f"Tilt the board with its {side} side farther away, and let the board fill half of the "
            "picture.",
            lean=lean,
        )
    if len(good) < FEWEST_PICTURES:
        missing_count = FEWEST_PICTURES - len(good)
        sentence = (
            f"Take {missing_count} more pictures, with the board turned and tilted differently."
        )
        return Goal(sentence, lean=(_LEANING, _LEANING), turn_deg=20.0 * missing_count)
    return None


def next_step(qualities: Sequence[ImageQuality]) -> str:
    """Sentence with the next action for the user; faults of the last image come first."""
    last = qualities[-1] if qualities else None
    if last is not None and not last.is_detected:
        return "Take it again: " + last.refusal
    if last is not None and last.faults:
        return f"Take it again: {last.faults[0]}."
    goal = next_goal(qualities)
    return ENOUGH if goal is None else goal.sentence


def adds_information(earlier: Sequence[ImageQuality], last: ImageQuality) -> bool:
    """True if a good image covers a new cell of the field or shows a new tilt."""
    qualities = [*earlier, last]
    if not last.is_good or covered_cells(qualities).sum() > covered_cells(earlier).sum():
        return last.is_good
    return len(_missing_sides(qualities)) < len(_missing_sides(earlier))


def summary_lines(qualities: Sequence[ImageQuality]) -> list[str]:
    """Two lines: numbers of good and bad images with the covered field, and the next step."""
    good = sum(quality.is_good for quality in qualities)
    undetected = sum(not quality.is_detected for quality in qualities)
    counts = f"{len(qualities)} pictures: {good} good, {undetected} without the board found, "
    counts += f"{len(qualities) - good - undetected} to take again"
    return [f"{counts}; {field_share(qualities):.0%} of the field covered.", next_step(qualities)]


def _emptiest(cells: Bool[np.ndarray, "r c"]) -> tuple[str, tuple[float, float]]:
    """(name, position) of the least covered of the 3 x 3 equal parts of the field.

    The position is the middle of an uncovered cell, in shares of the image's width and height.
    """
    bands = [
        np.array_split(band, 3, axis=1)
        for band in np.array_split(np.arange(cells.size).reshape(cells.shape), 3)
    ]
    ninths = [ninth.ravel() for band in bands for ninth in band]
    shares = [cells.flat[ninth].mean() for ninth in ninths]
    # The middle contains the least information on the lens: among equals it comes last.
    emptiest = min(range(9), key=lambda k: (shares[k], _NINTHS[k] == "the middle"))
    empty_cells = ninths[emptiest][~cells.flat[ninths[emptiest]]]
    row, column = np.divmod(empty_cells, cells.shape[1])
    middles = (np.stack([column, row], axis=1) + 0.5) / cells.shape[::-1]
    nearest = np.argmin(np.linalg.norm(middles - middles.mean(axis=0), axis=1))
    across, down = middles[nearest].tolist()
    return _NINTHS[emptiest], (across, down)


def _missing_sides(qualities: Sequence[ImageQuality]) -> list[tuple[str, int, int]]:
    """Rows of `_SIDES` for the board's sides that were not yet the far side in a good image."""
    leans = np.array([quality.lean for quality in qualities if quality.is_good]).reshape(-1, 2)
    return [row for row in _SIDES if not (row[2] * leans[:, row[1]] > LEAN).any()]
