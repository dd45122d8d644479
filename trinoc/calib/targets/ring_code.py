"""Ring code of a sheet: the choice of rings among the circles that makes parts of it unique.

A window is a block of neighbouring circles. A code has no conflict for a window size if all windows
differ, also after any of the four rotations or mirror images. One visible window then determines
its position and orientation on the sheet, and a mirrored image.
"""

import functools
import math

import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError

# Each part of a criterion: (window rows, window columns), and the fewest circles in which two
# windows must differ. With a difference of three circles, one circle may be misread. The code
# meets the first criterion for which the grid is large enough and the search succeeds.
_Criterion = tuple[tuple[tuple[int, int], int], ...]
# numerical: requirements on a code; other numbers would change the printed sheets.
_CRITERIA: tuple[_Criterion, ...] = (
    (((3, 3), 1), ((4, 4), 3)),
    (((3, 4), 1), ((4, 4), 3)),
    (((4, 4), 1), ((5, 5), 3)),
    (((4, 5), 1), ((5, 6), 3)),
)
# numerical: steps and temperature of the search; other numbers would change the sheets.
_STEPS, _TEMPERATURE = 1000, 0.7
# numerical: largest share of all code words that the windows may use: the search fails above.
_FILLED = 0.55
# numerical: larger grids do not fit one sheet of paper.
_MOST_CIRCLES = 1600


def ring_code(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Mask of the circles of a grid that are rings, row 0 on top; the others are discs.

    The rings are chosen so that a visible block of neighbouring circles determines its position and
    orientation on the sheet. The search first tries blocks of 3 x 3 circles, then larger ones. The
    result is the same at every call. A grid of fewer than three rows or columns has one or two
    rings. They distinguish its rotations and its mirror image, if the grid allows this.

    Parameters
    ----------
    rows, columns : numbers of circles.
    """
    return _ring_code(rows, columns).copy()


@functools.cache
def _ring_code(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    if rows * columns > _MOST_CIRCLES:
        raise InputError(
            f"A ring code for {rows} x {columns} circles is not available: use at most "
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
    """True if enough code words exist for all windows of a grid in all orientations.

    A window is a block of neighbouring circles; its rings and discs form a code word. The number of
    code words that differ in at least `distance` circles is estimated by the sphere-packing bound.

    window : (rows, columns) of a window.
    """
    count = sum(
        max(rows - height + 1, 0) * max(columns - width + 1, 0)
        for height, width in (window, window[::-1])
    )
    bits = window[0] * window[1]
    ball = sum(math.comb(bits, changed) for changed in range(distance))
    return 4 * count * ball <= _FILLED * 2**bits


def _fewest_rings(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Code with one ring that is on no symmetry axis of the grid.

    If one ring is ambiguous, the code has two rings.
    """
    code = np.zeros((rows, columns), dtype=bool)
    code[0, 1 if columns > 2 else 0] = True
    if is_ambiguous(code):
        code[0, 0] = True
    return code


def is_ambiguous(code: Bool[np.ndarray, "rows columns"]) -> bool:
    """True if a rotation or a reflection of the grid maps the rings onto themselves.

    Parameters
    ----------
    code : mask of the rings.
    """
    images = [np.rot90(flipped, turns) for flipped in (code, code[:, ::-1]) for turns in range(4)]
    return sum(image.shape == code.shape and bool(np.all(image == code)) for image in images) > 1


def _search(
    rows: int, columns: int, criterion: _Criterion
) -> Bool[np.ndarray, "rows columns"] | None:
    """Search for a code by simulated annealing with a fixed seed; None if it does not converge.

    criterion : requirements on the code. Each is a window size (rows, columns) and the smallest
        number of circles in which two windows must differ.
    """
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
    """Number of pairs of windows that differ in fewer than `distance` circles.

    A window is a block of neighbouring circles. All orientations of both windows are compared.

    Parameters
    ----------
    code : mask of the rings.
    window : (rows, columns) of a window.
    distance : smallest allowed number of different circles.
    """
    views = _windows_in_all_orientations(code, window)
    orientations, count, bits = views.shape
    if count == 0:
        return 0
    differing = (bits - views[0] @ views.reshape(orientations * count, bits).T) / 2
    return int(np.sum(differing < distance)) - count


def _windows_in_all_orientations(
    code: Bool[np.ndarray, "rows columns"], window: tuple[int, int]
) -> Float[np.ndarray, "orientations count bits"]:
    """All windows as vectors with +1 for a ring and -1 for a disc, in each orientation.

    The orientations are the rotations and reflections that keep the shape of the window.
    """
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
