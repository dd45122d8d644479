"""Which circles of a grid are rings, so that a part of the sheet tells where it lies.

A code is conflict-free for a window of the lattice when no two places, in any of the four
rotations or their mirror images, show the same rings and discs: a window then names its
place, its orientation, and whether the picture is mirrored.
"""

import functools
import math

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError

# Each criterion: (window rows, window columns) and how many circles, at least, must differ
# between two places. Three different circles let one be misread. The first criterion that the
# grid leaves room for and the search satisfies is taken.
_Criterion = tuple[tuple[tuple[int, int], int], ...]
# numerical: what a code must fulfil; other numbers would print other sheets.
_CRITERIA: tuple[_Criterion, ...] = (
    (((3, 3), 1), ((4, 4), 3)),
    (((3, 4), 1), ((4, 4), 3)),
    (((4, 4), 1), ((5, 5), 3)),
    (((4, 5), 1), ((5, 6), 3)),
)
# numerical: of the search, likewise.
_STEPS, _TEMPERATURE = 1000, 0.7
# numerical: share of all words of a window's length that places may fill: beyond, no search ends.
_FILLED = 0.55
# numerical: larger grids are beyond what one sheet of paper holds.
_MOST_CIRCLES = 1600


def ring_code(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Rings (True) and discs of a grid, the same at every call; row 0 is the top one.

    The smaller the windows that name their place, the better; grids with fewer than nine
    circles in a block get the fewest rings that tell the four rotations and the mirror image
    apart, if any do.
    """
    return _ring_code(rows, columns).copy()


@functools.cache
def _ring_code(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    if rows * columns > _MOST_CIRCLES:
        raise InputError(
            f"A ring code for {rows} x {columns} circles is not searched for: take at most "
            f"{_MOST_CIRCLES} circles, or give `rings=` in Python."
        )
    if min(rows, columns) < 3:
        return _fewest_rings(rows, columns)
    for criterion in _CRITERIA:
        if all(_has_room(rows, columns, window, distance) for window, distance in criterion):
            code = _search(rows, columns, criterion)
            if code is not None:
                return code
    return _fewest_rings(rows, columns)


def _has_room(rows: int, columns: int, window: tuple[int, int], distance: int) -> bool:
    """Whether words `distance` apart suffice for all orientations of all windows."""
    count = sum(
        max(rows - height + 1, 0) * max(columns - width + 1, 0)
        for height, width in (window, window[::-1])
    )
    bits = window[0] * window[1]
    ball = sum(math.comb(bits, changed) for changed in range(distance))
    return 4 * count * ball <= _FILLED * 2**bits


def _fewest_rings(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """One ring off every axis of symmetry of the grid, or as near to it as the grid allows."""
    code = np.zeros((rows, columns), dtype=bool)
    code[0, 1 if columns > 2 else 0] = True
    if is_ambiguous(code):
        code[0, 0] = True
    return code


def is_ambiguous(code: Bool[np.ndarray, "rows columns"]) -> bool:
    """Whether a rotation or a mirror image of the whole grid shows the same rings."""
    images = [np.rot90(flipped, turns) for flipped in (code, code[:, ::-1]) for turns in range(4)]
    return sum(image.shape == code.shape and bool(np.all(image == code)) for image in images) > 1


def _search(
    rows: int, columns: int, criterion: _Criterion
) -> Bool[np.ndarray, "rows columns"] | None:
    """Annealing by single flips from a fixed seed; None when the steps do not suffice."""
    # RandomState: its stream is frozen by NumPy's policy, a Generator's is not.
    random = np.random.RandomState(1986)
    code = random.randint(0, 2, (rows, columns)).astype(bool)
    cost = _cost(code, criterion)
    for _ in range(_STEPS):
        if cost == 0:
            return code
        row, column = random.randint(0, rows), random.randint(0, columns)
        code[row, column] ^= True
        changed = _cost(code, criterion)
        if changed <= cost or random.rand() < np.exp((cost - changed) / _TEMPERATURE):
            cost = changed
        else:
            code[row, column] ^= True
    return None


def _cost(code: Bool[np.ndarray, "rows columns"], criterion: _Criterion) -> int:
    return sum(conflicts(code, window, distance) for window, distance in criterion)


def conflicts(
    code: Bool[np.ndarray, "rows columns"], window: tuple[int, int], distance: int
) -> int:
    """Pairs (a window; another, or itself, in some orientation) closer than `distance`."""
    views = _windows_in_all_orientations(code, window)
    orientations, count, bits = views.shape
    if count == 0:
        return 0
    differing = (bits - views[0] @ views.reshape(orientations * count, bits).T) / 2
    return int(np.sum(differing < distance)) - count


def _windows_in_all_orientations(
    code: Bool[np.ndarray, "rows columns"], window: tuple[int, int]
) -> Float[np.ndarray, "orientations count bits"]:
    """Every window as signs, in the orientations that keep its shape."""
    rows, columns = window
    plain = _windows(code, rows, columns)
    if rows != columns:
        plain = np.concatenate([plain, np.rot90(_windows(code, columns, rows), 1, (1, 2))])
    views = [plain, np.rot90(plain, 2, (1, 2)), plain[:, :, ::-1], plain[:, ::-1]]
    if rows == columns:
        views += [np.rot90(view, 1, (1, 2)) for view in views]
    signs = [np.where(view, 1.0, -1.0).reshape(len(plain), rows * columns) for view in views]
    return np.stack(signs)


def _windows(
    code: Bool[np.ndarray, "rows columns"], rows: int, columns: int
) -> Bool[np.ndarray, "count window_rows window_columns"]:
    if code.shape[0] < rows or code.shape[1] < columns:
        return np.zeros((0, rows, columns), dtype=bool)
    views = np.lib.stride_tricks.sliding_window_view(code, (rows, columns))
    return views.reshape(-1, rows, columns)
