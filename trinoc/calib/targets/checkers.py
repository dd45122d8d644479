"""Chessboard, and ChArUco board (a chessboard with ArUco markers in its light squares)."""

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
    """Chessboard, described by its inner corners as in OpenCV. The top left square is dark.

    The corners are ordered row by row from the top left. The origin is the centre of the board.

    Attributes
    ----------
    rows, columns : numbers of inner corners, each one less than the number of squares. OpenCV's
        patternSize is (columns, rows).
    square_mm : side of a square. If it is unknown, give 1; the unit of length is then a square.
    name : name of the board; made from its sizes if None.
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
        """Inner corners in the board's frame, row by row from the top left."""
        return grid_mm(self.rows, self.columns, self.square_mm, top_first=True)

    @property
    def nodes_mm(self) -> Float[np.ndarray, "k 2"]:
        """Corners of all squares, including those on the outer edge of the board."""
        return grid_mm(self.rows + 2, self.columns + 2, self.square_mm, top_first=True)

    @property
    def marks(self) -> Marks:
        """Features that distinguish chessboards: the counts of inner corners along the sides."""
        fewer, more = sorted((self.rows, self.columns))
        return Marks(
            f"chessboard of {fewer} x {more}",
            range(1),
            f"both are chessboards of {fewer} x {more} inner corners; give them different "
            "numbers of rows or columns, or use boards with markers",
        )

    def cell_grids(self, *, quarters: int = 0) -> list[CellGrid]:
        """Dark squares, as one grid.

        Parameters
        ----------
        quarters : without effect, because the board has no tags.
        """
        dark = dark_squares(self.rows + 1, self.columns + 1)
        return [CellGrid(dark, self.square_mm, np.zeros(2))]

    @property
    def turns(self) -> Int[np.ndarray, "k n"]:
        """Permutations of the corners by the rotations that map the board onto itself.

        Each row is one rotation, the identity first. Entry i is the index of the corner that moves
        to the position of corner i.
        """
        grid = np.arange(self.rows * self.columns).reshape(self.rows, self.columns)
        dark = dark_squares(self.rows + 1, self.columns + 1)
        permutations = [
            np.rot90(grid, quarters).ravel()
            for quarters in range(4)
            if np.rot90(grid, quarters).shape == grid.shape
            and np.array_equal(np.rot90(dark, quarters), dark)
        ]
        return np.stack(permutations)


class Charuco(AbstractSquareBoard):
    """Chessboard with ArUco markers in its light squares, like `cv2.aruco.CharucoBoard`.

    The corners can also be labelled if only a part of the board is visible. They have OpenCV's
    order: row by row from the top left. The origin is the centre of the board.

    Attributes
    ----------
    rows, columns : numbers of squares. OpenCV's size is (columns, rows).
    square_mm : side of a square.
    marker_mm : side of a marker; 0.75 `square_mm` if None.
    dictionary : marker dictionary, such as "4x4_50"; one of `DICTIONARIES`.
    legacy : True for the layout before OpenCV 4.6, which has a marker in the top left square if the
        number of rows is even.
    first : id of the first marker.
    inverted : True if black and white are exchanged in print. The paper around the board stays
        white.
    mirrored : True for a mirror-image print, such as the back of a two-sided board. Seen from the
        printed side, the first corner is at the top right.
    name : name of the board; made from its sizes if None.
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
        side_mm = 0.75 * self.square_mm if marker_mm is None else marker_mm
        self.marker_mm = real_number(side_mm, "marker_mm")
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
        """Inner corners in the board's frame, row by row."""
        counts = (self.rows - 1, self.columns - 1)
        return grid_mm(*counts, self.square_mm, top_first=True, right_first=self.mirrored)

    @property
    def nodes_mm(self) -> Float[np.ndarray, "k 2"]:
        """Corners of all squares, including those on the outer edge of the board."""
        return grid_mm(self.rows + 1, self.columns + 1, self.square_mm, top_first=True)

    @property
    def marks(self) -> Marks:
        """Marker family and ids, by which an image distinguishes the board from other boards.

        Inverted and mirrored markers each form a separate family.
        """
        marks = marks_of_markers(self.dictionary, self.marker_ids)
        looks = [word for word in ("inverted", "mirrored") if getattr(self, word)]
        return marks._replace(family=" ".join([marks.family, *looks]))

    @property
    def marker_ids(self) -> range:
        """Ids of the board's markers."""
        return range(self.first, self.first + self.rows * self.columns // 2)

    @property
    def _is_dark(self) -> Bool[np.ndarray, "rows columns"]:
        """Mask of the dark squares of a print that is neither inverted nor mirrored.

        The light squares contain the markers. Their ids increase row by row from the top left.
        """
        return dark_squares(self.rows, self.columns) ^ (self.legacy and self.rows % 2 == 0)

    @property
    def markers_mm(self) -> Float[np.ndarray, "m 2"]:
        """Centres of the markers in the board's frame, in the order of their ids."""
        counts = (self.rows, self.columns)
        squares = grid_mm(*counts, self.square_mm, top_first=True, right_first=self.mirrored)
        return squares[~self._is_dark.ravel()]

    def cell_grids(self, *, quarters: int = 0) -> list[CellGrid]:
        """Dark squares and inked marker cells. On an inverted board, all other cells are inked.

        Parameters
        ----------
        quarters : see `AbstractSquareBoard.cell_grids`.
        """
        dictionary, middle_mm = opencv_dictionary(self.dictionary), np.zeros(2)
        across = slice(None, None, -1 if self.mirrored else 1)
        grids = [CellGrid(self._is_dark[:, across], self.square_mm, middle_mm)]
        for marker_id, middle in enumerate(self.markers_mm, self.first):
            cells = np.rot90(marker_cells(dictionary, marker_id, border=1), quarters)[:, across]
            grids.append(CellGrid(cells, self.marker_mm / len(cells), middle))
        if not self.inverted:
            return grids
        all_squares = CellGrid(np.ones_like(self._is_dark), self.square_mm, middle_mm)
        return [all_squares, *(grid._replace(is_blank=True) for grid in grids)]


def opencv_board(board: Charuco) -> Any:
    """OpenCV's `cv2.aruco.CharucoBoard` for the board, printed neither inverted nor mirrored.

    Parameters
    ----------
    board : the board.
    """
    import cv2

    charuco_board = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square_mm,
        board.marker_mm,
        opencv_dictionary(board.dictionary),
        np.array(board.marker_ids),
    )
    charuco_board.setLegacyPattern(board.legacy)
    return charuco_board
