"""Several boards fixed to each other, such as on the sides of a cube or on two walls."""

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

# The kinds of boards by the word for them in layout files and commands.
BOARDS: dict[str, type[AbstractBoard]] = {
    board.kind: board for board in (Pattern, Chessboard, Charuco, AprilGrid)
}


class BoardSet(AbstractTarget):
    """Boards fixed to each other in places that nobody knows and that the shots determine.

    The first board is the reference: its frame is that of the set. Places are those of the boards
    one after the other, each in the frame of its own board.

    Fields
    ------
    names : of the boards, in order.
    boards : those that a picture can tell from each other (`Marks`): by kind, by numbers of
        corners, by dictionaries, or by the numbers of their markers.
    name : what the set is called; from its boards unless given.

    Raises
    ------
    InputError : no board, two of one name, a set in a set, or two boards that look alike.
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
                    f'The board "{board_name}" is a set itself: give its boards singly.'
                )
        self.names = tuple(board_name for board_name, _ in named)
        self.boards = tuple(board for _, board in named if isinstance(board, AbstractBoard))
        self.name = name or " + ".join(self.names)

    def __check_init__(self) -> None:
        if not self.boards:
            raise InputError("A set of boards needs at least one board: give it.")
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(f'Two boards are called "{name}": give each a name of its own.')
        members = zip(self.names, self.boards, strict=True)
        for (first, board), (second, other) in combinations(members, 2):
            likeness = board.marks.likeness_to(other.marks)
            if likeness is not None:
                raise InputError(
                    f'The boards "{first}" and "{second}" look alike in view: {likeness}.'
                )

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """The places of all boards, each in the frame of its own."""
        return np.concatenate([board.centres_mm for board in self.boards])

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """The radii of all boards' circles; 0 for corners."""
        return np.concatenate([board.radius_mm for board in self.boards])

    @property
    def board_of_place(self) -> Int[np.ndarray, "n"]:
        """Which of the boards each place is on."""
        return np.repeat(np.arange(len(self.boards)), [len(board) for board in self.boards])


def list_boards(target: AbstractTarget) -> tuple[AbstractTarget, ...]:
    """The boards of a set; a board alone is its own."""
    return target.boards if isinstance(target, BoardSet) else (target,)


# Of a board fixed to others: its turn about the axes of their frame from where it stands, and where
# its origin lies there.
IN_SET_NAMES = ("turn_x_deg", "turn_y_deg", "turn_z_deg", "x_mm", "y_mm", "z_mm")


def board_names(target: AbstractTarget) -> tuple[str, ...]:
    """What the boards are called."""
    return target.names if isinstance(target, BoardSet) else (target.name,)


def board_prefixes(target: AbstractTarget) -> tuple[str, ...]:
    """What the names of each board's parameters begin with."""
    if not isinstance(target, BoardSet):
        return ("board.",)
    return tuple(f"board.{name}." for name in target.names)


def first_places(target: AbstractTarget) -> Int[np.ndarray, "b"]:
    """The index of each board's first place among all."""
    return np.cumsum([0, *(len(board) for board in list_boards(target))])[:-1]
