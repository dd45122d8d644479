"""Several boards fixed to each other, such as the sides of a cube or boards on two walls."""

from collections.abc import Mapping, Sequence
from itertools import combinations

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.calib.targets.abstract_target import AbstractBoard, AbstractTarget
from trinoc.calib.targets.april_grid import AprilGrid
from trinoc.calib.targets.checkers import Charuco, Chessboard
from trinoc.calib.targets.pattern import Pattern
from trinoc.errors import InputError

# Board classes by the name of their kind in layout files and on the command line.
BOARDS: dict[str, type[AbstractBoard]] = {
    board.kind: board for board in (Pattern, Chessboard, Charuco, AprilGrid)
}


class BoardSet(AbstractTarget):
    """Boards fixed to each other. A calibration estimates their relative poses.

    The first board is the reference: its frame is the frame of the set. The points of the set are
    the points of all boards in order. Each point is given in the frame of its own board.

    Attributes
    ----------
    names : names of the boards, in order.
    boards : the boards. An image must be able to distinguish them by kind, number of corners,
        dictionary, or marker ids.
    name : name of the set; made from the names of its boards if None.

    Raises
    ------
    InputError : the set is empty or contains a set, or two of its boards have the same name or
        cannot be distinguished.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    boards: tuple[AbstractBoard, ...]
    name: str = eqx.field(static=True)

    def __init__(
        self,
        boards: Mapping[str, AbstractTarget] | Sequence[AbstractTarget],
        *,
        name: str | None = None,
    ) -> None:
        if isinstance(boards, Mapping):
            named = list(boards.items())
        else:
            named = [(board.name, board) for board in boards]
        for board_name, board in named:
            if not isinstance(board, AbstractBoard):
                raise InputError(
                    f'The board "{board_name}" is itself a set of boards: give each board of that '
                    "set separately."
                )
        self.names = tuple(board_name for board_name, _ in named)
        self.boards = tuple(board for _, board in named if isinstance(board, AbstractBoard))
        self.name = name or " + ".join(self.names)

    def __check_init__(self) -> None:
        if not self.boards:
            raise InputError("A set of boards needs at least one board: give one.")
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(
                    f'Two boards have the name "{name}": give each board its own name.'
                )
        members = zip(self.names, self.boards, strict=True)
        for (first, board), (second, other) in combinations(members, 2):
            likeness = board.marks.likeness_to(other.marks)
            if likeness is not None:
                raise InputError(
                    f'The boards "{first}" and "{second}" look alike in an image: {likeness}.'
                )

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """Points of all boards, each in the frame of its own board."""
        return np.concatenate([board.centres_mm for board in self.boards])

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """Radii of the circles of all boards; 0 for corners."""
        return np.concatenate([board.radius_mm for board in self.boards])

    @property
    def board_of_point(self) -> Int[np.ndarray, "n"]:
        """Index of the board of each point, (n,)."""
        return np.repeat(np.arange(len(self.boards)), [len(board) for board in self.boards])


def list_boards(target: AbstractTarget) -> tuple[AbstractTarget, ...]:
    """List the boards of a set; the list for a single board contains this board.

    Parameters
    ----------
    target : a board or a set of boards.
    """
    return target.boards if isinstance(target, BoardSet) else (target,)


# Parameters of a board in a set, in the frame of the set: its rotation about the axes relative to
# the estimated pose, and the position of its origin.
IN_SET_NAMES = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


def board_names(target: AbstractTarget) -> tuple[str, ...]:
    """Names of the boards of a set in order, or the name of a single board.

    Parameters
    ----------
    target : a board or a set of boards.
    """
    return target.names if isinstance(target, BoardSet) else (target.name,)


def board_prefixes(target: AbstractTarget) -> tuple[str, ...]:
    """Prefix of the parameter names of each board, such as "board.left.".

    Parameters
    ----------
    target : a board or a set of boards.
    """
    if not isinstance(target, BoardSet):
        return ("board.",)
    return tuple(f"board.{name}." for name in target.names)


def first_point_indices(target: AbstractTarget) -> Int[np.ndarray, "b"]:
    """Index of the first point of each board among all points of the target.

    Parameters
    ----------
    target : a board or a set of boards.
    """
    return np.cumsum([0, *(len(board) for board in list_boards(target))])[:-1]
