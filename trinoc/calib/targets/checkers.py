"""Boards of squares: the chessboard, and the chessboard with markers in its light squares."""

from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.targets.abstract_target import Marks
from trinoc.calib.targets.markers import (
    check_markers,
    marker_cells,
    marks_of_markers,
    opencv_dictionary,
)
from trinoc.calib.targets.squares import (
    AbstractSquareBoard,
    CellGrid,
    check_size,
    dark_squares,
    grid_mm,
)
from trinoc.errors import InputError, real_number, whole_number


class Chessboard(AbstractSquareBoard):
    """A chessboard, by its inner corners as OpenCV counts them; its top left square is dark.

    The corners are ordered row by row from the top left, the origin is in their middle.

    Fields
    ------
    rows, columns : inner corners, one less than there are squares; OpenCV's patternSize is
        (columns, rows).
    square_mm : side of a square; 1 where it is not known, and lengths are then in squares.
    name : what the board is called; from the numbers unless given.
    """

    kind: ClassVar[str] = "chessboard"
    layout: ClassVar[dict[str, str]] = {
        "inner_rows": "rows",
        "inner_columns": "columns",
        "square_mm": "square_mm",
    }

    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    square_mm: float = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self, *, rows: int, columns: int, square_mm: float, name: str | None = None
    ) -> None:
        self.rows, self.columns = whole_number(rows, "rows"), whole_number(columns, "columns")
        self.square_mm = real_number(square_mm, "square_mm")
        self.name = name or f"chessboard_{rows}x{columns}_{square_mm:g}mm"

    def __check_init__(self) -> None:
        check_size(self.name, self.rows, self.columns, "inner corners", self.square_mm)

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """The inner corners."""
        return grid_mm(self.rows, self.columns, self.square_mm, top_first=True)

    @property
    def nodes_mm(self) -> Float[np.ndarray, "k 2"]:
        """The corners of all squares."""
        return grid_mm(self.rows + 2, self.columns + 2, self.square_mm, top_first=True)

    @property
    def marks(self) -> Marks:
        """The numbers of inner corners, of which a chessboard's search finds just so many."""
        fewer, more = sorted((self.rows, self.columns))
        return Marks(
            f"chessboard of {fewer} x {more}",
            range(1),
            f"both are chessboards of {fewer} x {more} inner corners; give them different "
            "numbers of rows or columns, or take boards with markers",
        )

    def cell_grids(self, *, quarters: int = 0) -> list[CellGrid]:
        """The dark squares."""
        dark = dark_squares(self.rows + 1, self.columns + 1)
        return [CellGrid(dark, self.square_mm, np.zeros(2))]

    @property
    def turns(self) -> Int[np.ndarray, "k n"]:
        """For each turn of the board that leaves its corners and colours in place, the corner that
        comes to lie where each one was; the first is no turn."""
        grid = np.arange(self.rows * self.columns).reshape(self.rows, self.columns)
        dark = dark_squares(self.rows + 1, self.columns + 1)
        same = [
            np.rot90(grid, quarters).ravel()
            for quarters in range(4)
            if np.rot90(grid, quarters).shape == grid.shape
            and np.array_equal(np.rot90(dark, quarters), dark)
        ]
        return np.stack(same)


class Charuco(AbstractSquareBoard):
    """A chessboard with ArUco markers in its light squares, as `cv2.aruco.CharucoBoard` has it.

    A part of it shows where it lies. The corners are OpenCV's, in its order, row by row from the
    top left; the origin is in their middle.

    Fields
    ------
    rows, columns : squares; OpenCV's size is (columns, rows).
    square_mm, marker_mm : sides of a square and of a marker; 3/4 of it unless given.
    dictionary : of the markers, such as "4x4_50" (`DICTIONARIES`).
    legacy : whether the board was made before OpenCV 4.6, with a marker in the top left square
        where the number of rows is even.
    first : number of its first marker.
    inverted : whether it is printed white for black. Paper around it stays white.
    mirrored : whether it is printed as in a mirror, such as the back of a two-sided board. Seen
        from the printed side, its first corner is at the top right.
    name : what the board is called; from the numbers unless given.
    """

    kind: ClassVar[str] = "charuco"
    layout: ClassVar[dict[str, str]] = {
        key: key
        for key in (
            *("rows", "columns", "square_mm", "marker_mm", "dictionary"),
            *("legacy", "first", "inverted", "mirrored"),
        )
    }
    added_keys: ClassVar[tuple[str, ...]] = ("legacy", "first", "inverted", "mirrored")

    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    square_mm: float = eqx.field(static=True)
    marker_mm: float = eqx.field(static=True)
    dictionary: str = eqx.field(static=True)
    legacy: bool = eqx.field(static=True)
    first: int = eqx.field(static=True)
    inverted: bool = eqx.field(static=True)
    mirrored: bool = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self,
        *,
        rows: int,
        columns: int,
        square_mm: float,
        marker_mm: float | None = None,
        dictionary: str = "4x4_250",
        legacy: bool = False,
        first: int = 0,
        inverted: bool = False,
        mirrored: bool = False,
        name: str | None = None,
    ) -> None:
        self.rows, self.columns = whole_number(rows, "rows"), whole_number(columns, "columns")
        self.square_mm = real_number(square_mm, "square_mm")
        given_mm = 0.75 * self.square_mm if marker_mm is None else marker_mm
        self.marker_mm = real_number(given_mm, "marker_mm")
        self.dictionary, self.legacy = dictionary, bool(legacy)
        self.first = whole_number(first, "first")
        self.inverted, self.mirrored = bool(inverted), bool(mirrored)
        self.name = name or f"charuco_{rows}x{columns}_{square_mm:g}mm"

    def __check_init__(self) -> None:
        check_size(self.name, self.rows, self.columns, "squares", self.square_mm)
        if not 0.0 < self.marker_mm < self.square_mm:
            raise InputError(
                f"The board {self.name!r} has markers of {self.marker_mm:g} mm in squares of "
                f"{self.square_mm:g} mm: give markers smaller than the squares."
            )
        check_markers(self.name, self.dictionary, self.first, self.rows * self.columns // 2)

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """The corners between the squares."""
        counts = (self.rows - 1, self.columns - 1)
        return grid_mm(*counts, self.square_mm, top_first=True, right_first=self.mirrored)

    @property
    def nodes_mm(self) -> Float[np.ndarray, "k 2"]:
        """The corners of all squares."""
        return grid_mm(self.rows + 1, self.columns + 1, self.square_mm, top_first=True)

    @property
    def marks(self) -> Marks:
        """The numbers of its markers, which look otherwise where they are inverted or mirrored."""
        marks = marks_of_markers(self.dictionary, self.numbers)
        looks = [word for word in ("inverted", "mirrored") if getattr(self, word)]
        return marks._replace(family=" ".join([marks.family, *looks]))

    @property
    def numbers(self) -> range:
        """The numbers of its markers."""
        return range(self.first, self.first + self.rows * self.columns // 2)

    @property
    def _is_dark(self) -> Bool[np.ndarray, "rows columns"]:
        """Which squares of the plain print are dark: the others hold markers, numbered row by row
        from the top left."""
        return dark_squares(self.rows, self.columns) ^ (self.legacy and self.rows % 2 == 0)

    @property
    def markers_mm(self) -> Float[np.ndarray, "m 2"]:
        """The middles of the markers, in the order of their numbers."""
        counts = (self.rows, self.columns)
        squares = grid_mm(*counts, self.square_mm, top_first=True, right_first=self.mirrored)
        return squares[~self._is_dark.ravel()]

    def cell_grids(self, *, quarters: int = 0) -> list[CellGrid]:
        """The dark squares, and the cells of the markers; of an inverted board, all but these."""
        dictionary, middle_mm = opencv_dictionary(self.dictionary), np.zeros(2)
        across = slice(None, None, -1 if self.mirrored else 1)
        grids = [CellGrid(self._is_dark[:, across], self.square_mm, middle_mm)]
        for number, middle in enumerate(self.markers_mm, self.first):
            cells = np.rot90(marker_cells(dictionary, number, border=1), quarters)[:, across]
            grids.append(CellGrid(cells, self.marker_mm / len(cells), middle))
        if not self.inverted:
            return grids
        whole = CellGrid(np.ones_like(self._is_dark), self.square_mm, middle_mm)
        return [whole, *(grid._replace(is_blank=True) for grid in grids)]


def opencv_board(board: Charuco) -> Any:
    """The plain print of a board as a `cv2.aruco.CharucoBoard`, neither inverted nor mirrored."""
    import cv2

    theirs = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square_mm,
        board.marker_mm,
        opencv_dictionary(board.dictionary),
        np.array(board.numbers),
    )
    theirs.setLegacyPattern(board.legacy)
    return theirs
