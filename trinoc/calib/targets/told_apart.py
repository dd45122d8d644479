"""Can a picture of two boards tell which is which?"""

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern


def why_alike(first: AbstractTarget, second: AbstractTarget) -> str | None:
    """Why not, and what to do, in words; None where it can."""
    if isinstance(first, Pattern) and isinstance(second, Pattern):
        return "both are sheets of circles, of which a set may have one; take other boards"
    if isinstance(first, Pattern) or isinstance(second, Pattern):
        return None
    mine, other = _corners(first), _corners(second)
    if mine is not None and mine == other:
        rows, columns = mine
        return (
            f"both are chessboards of {rows} x {columns} inner corners; give them different "
            "numbers of rows or columns, or take boards with markers"
        )
    ours, theirs = _markers(first), _markers(second)
    if ours is None or theirs is None or ours[0] != theirs[0]:
        return None
    shared = range(max(ours[1].start, theirs[1].start), min(ours[1].stop, theirs[1].stop))
    if not shared:
        return None
    numbers = f"s {shared.start} to {shared.stop - 1}" if len(shared) > 1 else f" {shared.start}"
    return (
        f"both have the marker{numbers} of {ours[0]}; give them "
        "different dictionaries, or numbers that differ (`first`)"
    )


def _corners(board: AbstractTarget) -> tuple[int, int] | None:
    """Inner corners, the fewer first, of which a chessboard's search finds just so many."""
    if isinstance(board, Chessboard):
        fewer, more = sorted((board.rows, board.columns))
        return fewer, more
    return None


def _markers(board: AbstractTarget) -> tuple[str, range] | None:
    """The family of a board's markers, and their numbers in it.

    ArUco's dictionaries of one size begin with the same markers.
    """
    if isinstance(board, Charuco):
        count = board.rows * board.columns // 2
        family = _family(board.dictionary)
        return family, range(board.first, board.first + count)
    if isinstance(board, AprilGrid):
        return _family(board.dictionary), range(
            board.first, board.first + board.rows * board.columns
        )
    return None


def _family(dictionary: str) -> str:
    own, count = dictionary.split("_")
    return own if count.isdigit() else dictionary
