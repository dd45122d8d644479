"""Boards of squares: the chessboard, and the chessboard with markers in its light squares."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.calib.targets.abstract_target import AbstractTarget
from trinoc.errors import InputError

# ArUco's dictionaries as OpenCV's names have them, less the prefix DICT_.
DICTIONARIES = (
    *(f"{bits}x{bits}_{count}" for bits in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    *("ARUCO_ORIGINAL", "APRILTAG_16h5", "APRILTAG_25h9", "APRILTAG_36h10", "APRILTAG_36h11"),
)


# How many markers the others hold.
_COUNTS = {
    "ARUCO_ORIGINAL": 1024,
    "APRILTAG_16h5": 30,
    "APRILTAG_25h9": 35,
    "APRILTAG_36h10": 2320,
    "APRILTAG_36h11": 587,
}


class Chessboard(AbstractTarget):
    """A chessboard, by its inner corners as OpenCV counts them; its top left square is dark.

    The corners are ordered row by row from the top left, the origin is in their middle.

    Fields
    ------
    rows, columns : inner corners, one less than there are squares; OpenCV's patternSize is
        (columns, rows).
    square_mm : side of a square; 1 where it is not known, and lengths are then in squares.
    name : what the board is called; from the numbers unless given.
    """

    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    square_mm: float = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self, *, rows: int, columns: int, square_mm: float, name: str | None = None
    ) -> None:
        self.rows, self.columns, self.square_mm = int(rows), int(columns), float(square_mm)
        self.name = name or f"chessboard_{rows}x{columns}_{square_mm:g}mm"

    def __check_init__(self) -> None:
        _check_squares(self.name, min(self.rows, self.columns), 3, self.square_mm)

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """The inner corners."""
        return inner_corners_mm(self.rows, self.columns, self.square_mm)

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """Zeros: corners have none."""
        return np.zeros(self.rows * self.columns)

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


class Charuco(AbstractTarget):
    """A chessboard with ArUco markers in its light squares, as `cv2.aruco.CharucoBoard` has it.

    A part of it tells where it lies. The corners are OpenCV's, in its order, row by row from the
    top left; the origin is in their middle.

    Fields
    ------
    rows, columns : squares; OpenCV's size is (columns, rows).
    square_mm, marker_mm : sides of a square and of a marker.
    dictionary : of the markers, such as "4x4_50" (`DICTIONARIES`).
    legacy : whether the board was made before OpenCV 4.6, with a marker in the top left square
        where the number of rows is even.
    first : number of its first marker.
    name : what the board is called; from the numbers unless given.
    """

    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    square_mm: float = eqx.field(static=True)
    marker_mm: float = eqx.field(static=True)
    dictionary: str = eqx.field(static=True)
    legacy: bool = eqx.field(static=True)
    first: int = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self,
        *,
        rows: int,
        columns: int,
        square_mm: float,
        marker_mm: float,
        dictionary: str = "4x4_250",
        legacy: bool = False,
        first: int = 0,
        name: str | None = None,
    ) -> None:
        self.rows, self.columns = int(rows), int(columns)
        self.square_mm, self.marker_mm = float(square_mm), float(marker_mm)
        self.dictionary, self.legacy, self.first = dictionary, bool(legacy), int(first)
        self.name = name or f"charuco_{rows}x{columns}_{square_mm:g}mm"

    def __check_init__(self) -> None:
        _check_squares(self.name, min(self.rows, self.columns), 3, self.square_mm)
        if not 0.0 < self.marker_mm < self.square_mm:
            raise InputError(
                f"The board {self.name!r} has markers of {self.marker_mm:g} mm in squares of "
                f"{self.square_mm:g} mm: give markers smaller than the squares."
            )
        if self.dictionary not in DICTIONARIES:
            raise InputError(
                f"The dictionary {self.dictionary!r} is unknown: give one of "
                f"{', '.join(DICTIONARIES)}."
            )
        last = self.first + self.rows * self.columns // 2 - 1
        held = _COUNTS.get(self.dictionary) or int(self.dictionary.split("_")[1])
        if self.first < 0 or (self.first > 0 and last >= held):
            raise InputError(
                f"The board {self.name!r} has the markers {self.first} to {last}, but "
                f"{self.dictionary} has 0 to {held - 1}: give another first one or dictionary."
            )

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """The corners between the squares."""
        return inner_corners_mm(self.rows - 1, self.columns - 1, self.square_mm)

    @property
    def radius_mm(self) -> Float[np.ndarray, "n"]:
        """Zeros: corners have none."""
        return np.zeros((self.rows - 1) * (self.columns - 1))


def inner_corners_mm(rows: int, columns: int, square_mm: float) -> Float[np.ndarray, "n 2"]:
    """Corners row by row from the top left, about their middle."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    across = np.stack([column - 0.5 * (columns - 1), 0.5 * (rows - 1) - row], axis=1)
    return square_mm * across


def dark_squares(rows: int, columns: int) -> Bool[np.ndarray, "rows columns"]:
    """Which squares of a chessboard are dark, the top left one among them."""
    return np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0


def _check_squares(name: str, fewest: int, least: int, square_mm: float) -> None:
    if fewest < least:
        raise InputError(f"The board {name!r} is too small: give at least {least} each way.")
    if not (np.isfinite(square_mm) and square_mm > 0.0):
        raise InputError(f"The board {name!r} has squares of {square_mm:g} mm: give their side.")
