from .abstract_target import AbstractTarget as AbstractTarget
from .april_grid import AprilGrid as AprilGrid
from .board_set import (
    BoardSet as BoardSet,
    board_names as board_names,
    board_prefixes as board_prefixes,
    boards_of as boards_of,
    first_places as first_places,
)
from .checkers import (
    DICTIONARIES as DICTIONARIES,
    Charuco as Charuco,
    Chessboard as Chessboard,
    dark_squares as dark_squares,
)
from .markers import (
    charuco_markers as charuco_markers,
    marker_cells as marker_cells,
    opencv_board as opencv_board,
    opencv_dictionary as opencv_dictionary,
)
from .pattern import Pattern as Pattern
from .proposal import SheetProposal as SheetProposal, propose_sheet as propose_sheet
from .squares import SquareSheet as SquareSheet, square_sheet as square_sheet
