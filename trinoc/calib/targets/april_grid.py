"""Board of AprilTags with small dark squares between their corners, as Kalibr prints it."""

from functools import lru_cache
from typing import ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float

from trinoc.calib.targets.abstract_target import Marks
from trinoc.calib.targets.markers import (
    check_markers,
    marker_cells,
    marks_of_markers,
    opencv_dictionary,
)
from trinoc.calib.targets.squares import MOST_EACH_WAY, AbstractSquareBoard, CellGrid, grid_mm
from trinoc.errors import InputError, real_number, whole_number

# numerical: corners of a tag relative to its centre, in tag sides: from the lower left,
# counter-clockwise.
_CORNERS = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


class AprilGrid(AbstractSquareBoard):
    """Grid of AprilTags. The tag ids increase along the rows, from the lowest row upward.

    A dark square as wide as the gap between tags fills each crossing of two gaps. Every tag corner
    is therefore a saddle point like a corner of a chessboard. The points can also be labelled if
    only a part of the board is visible.

    The points are the tag corners, tag by tag: four per tag, from its lower left counter-clockwise.
    The origin is the centre of the board.

    Attributes
    ----------
    rows, columns : numbers of tags.
    tag_mm : side of a tag's ink, including its border.
    spacing : gap between two tags divided by the side of a tag; Kalibr's tagSpacing.
    dictionary : tag family, one of `DICTIONARIES`.
    border : width of a tag's black border in cells: 2 for Kalibr's boards, 1 for most others.
    first : id of the tag at the lower left.
    name : name of the board; made from its sizes if None.

    References
    ----------
    E. Olson, "AprilTag: a robust and flexible visual fiducial system", ICRA 2011.
    """

    kind: ClassVar[str] = "aprilgrid"
    layout: ClassVar[dict[str, str]] = {
        key: key
        for key in ("rows", "columns", "tag_mm", "spacing", "dictionary", "border", "first")
    }
    added_keys: ClassVar[tuple[str, ...]] = ("border", "first")

    rows: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)
    tag_mm: float = eqx.field(static=True)
    spacing: float = eqx.field(static=True)
    dictionary: str = eqx.field(static=True)
    border: int = eqx.field(static=True)
    first: int = eqx.field(static=True)
    name: str = eqx.field(static=True)

    def __init__(
        self,
        *,
        rows: int,
        columns: int,
        tag_mm: float,
        spacing: float = 0.3,
        dictionary: str = "APRILTAG_36h11",
        border: int = 2,
        first: int = 0,
        name: str | None = None,
    ) -> None:
        self.rows, self.columns = whole_number(rows, "rows"), whole_number(columns, "columns")
        self.first, self.border = whole_number(first, "first"), whole_number(border, "border")
        self.tag_mm, self.spacing = real_number(tag_mm, "tag_mm"), real_number(spacing, "spacing")
        self.dictionary = dictionary
        self.name = name or f"aprilgrid_{rows}x{columns}_{tag_mm:g}mm"

    def __check_init__(self) -> None:
        if min(self.rows, self.columns) < 1 or self.rows * self.columns < 2:
            raise InputError(f"The board {self.name!r} is too small: give at least two tags.")
        if max(self.rows, self.columns) > MOST_EACH_WAY:
            raise InputError(
                f"The board {self.name!r} is too large: give {MOST_EACH_WAY} tags each way at most."
            )
        if not (np.isfinite(self.tag_mm) and self.tag_mm > 0.0):
            raise InputError(
                f"The board {self.name!r} has tags of {self.tag_mm:g} mm: give a positive side."
            )
        if not 0.05 <= self.spacing <= 1.0:
            raise InputError(
                f"The board {self.name!r} has a spacing of {self.spacing:g}: give the width of a "
                "gap divided by the side of a tag, from .05 to 1."
            )
        if self.border not in (1, 2) or self.first < 0:
            raise InputError(
                f"The board {self.name!r} has a border of {self.border} cells and the first tag "
                f"{self.first}: give a border of 1 or 2 cells, and a first tag of 0 or more."
            )
        check_markers(self.name, self.dictionary, self.first, self.rows * self.columns)

    @property
    def tags_mm(self) -> Float[np.ndarray, "t 2"]:
        """Centres of the tags in the board's frame, in the order of their ids."""
        return grid_mm(self.rows, self.columns, self._pitch_mm, top_first=False)

    @property
    def _pitch_mm(self) -> float:
        return self.tag_mm * (1 + self.spacing)

    @property
    def centres_mm(self) -> Float[np.ndarray, "n 2"]:
        """Corners of the tags in the board's frame, four per tag."""
        return _corners_mm(self.rows, self.columns, self._pitch_mm, self.tag_mm)

    @property
    def nodes_mm(self) -> Float[np.ndarray, "k 2"]:
        """Corners of the tags; see `AbstractSquareBoard`."""
        return self.centres_mm

    @property
    def marks(self) -> Marks:
        """Tag family and tag ids, by which an image distinguishes the board from other boards."""
        return marks_of_markers(self.dictionary, self.marker_ids)

    @property
    def marker_ids(self) -> range:
        """Ids of the board's tags."""
        return range(self.first, self.first + self.rows * self.columns)

    def cell_grids(self, *, quarters: int = 0) -> list[CellGrid]:
        """Cells of the tags, and dark squares at the crossings of the gaps.

        Squares along the outer edge of the board are included.

        Parameters
        ----------
        quarters : see `AbstractSquareBoard.cell_grids`.
        """
        dictionary, grids = opencv_dictionary(self.dictionary), []
        for marker_id, middle in enumerate(self.tags_mm, self.first):
            cells = np.rot90(marker_cells(dictionary, marker_id, border=self.border), quarters)
            grids.append(CellGrid(cells, self.tag_mm / len(cells), middle))
        crossings = grid_mm(self.rows + 1, self.columns + 1, self._pitch_mm, top_first=False)
        square, gap_mm = np.ones((1, 1), dtype=bool), self.tag_mm * self.spacing
        return [*grids, *(CellGrid(square, gap_mm, middle) for middle in crossings)]


@lru_cache
def _corners_mm(
    rows: int, columns: int, pitch_mm: float, tag_mm: float
) -> Float[np.ndarray, "n 2"]:
    """Corners of the tags in the board's frame, mm. The array is cached and therefore read-only."""
    middles = grid_mm(rows, columns, pitch_mm, top_first=False)
    corners = (middles[:, None] + tag_mm * _CORNERS).reshape(-1, 2)
    corners.flags.writeable = False
    return corners
