"""Boards: the printed sheet of circles and crossed lines, boards of squares and tags, and sets."""

from trinoc.calib.targets.abstract_target import (
    AbstractBoard as AbstractBoard,
    AbstractTarget as AbstractTarget,
    Disc as Disc,
    Marks as Marks,
    Polygon as Polygon,
)
from trinoc.calib.targets.april_grid import AprilGrid as AprilGrid
from trinoc.calib.targets.board_set import (
    BoardSet as BoardSet,
    board_names as board_names,
    board_prefixes as board_prefixes,
    boards_of as boards_of,
    first_places as first_places,
)
from trinoc.calib.targets.checkers import (
    Charuco as Charuco,
    Chessboard as Chessboard,
    opencv_board as opencv_board,
)
from trinoc.calib.targets.markers import (
    DICTIONARIES as DICTIONARIES,
    marker_cells as marker_cells,
    opencv_dictionary as opencv_dictionary,
)
from trinoc.calib.targets.pattern import Pattern as Pattern
from trinoc.calib.targets.printing import (
    PrintedSheet as PrintedSheet,
    SheetProposal as SheetProposal,
    printed_sheet as printed_sheet,
    propose_sheet as propose_sheet,
)
from trinoc.calib.targets.squares import (
    AbstractSquareBoard as AbstractSquareBoard,
    CellGrid as CellGrid,
    SquareSheet as SquareSheet,
    dark_squares as dark_squares,
    square_sheet as square_sheet,
)

# The kinds of boards by the word for them in layout files and commands.
BOARDS: dict[str, type[AbstractBoard]] = {
    board.kind: board for board in (Pattern, Chessboard, Charuco, AprilGrid)
}
