"""Features in space: tables of corners, rims and the like, and their drawings as lines."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.display import Displayable
from trinoc.numerics.tables import Table


class Wires(NamedTuple):
    """Line drawing of features: points, straight lines between pairs of points, and faces.

    Attributes
    ----------
    points_mm : (n, 3)
        Points in the world frame.
    pairs : (e, 2)
        Indices of the two ends of each line.
    owner : (e,)
        Index of the feature that each line belongs to.
    loops : sequence of (k,)
        For each face, the indices of the points around it.
    """

    points_mm: Float[np.ndarray, "n 3"]
    pairs: Int[np.ndarray, "e 2"]
    owner: Int[np.ndarray, "e"]
    loops: Sequence[Int[np.ndarray, "_"]] = ()

    def lines(self) -> list[tuple[int, Float[np.ndarray, "_ 3"]]]:
        """(owner, points) of each polyline: consecutive pairs that share an end are joined."""
        ends = (self.pairs[1:, 0] != self.pairs[:-1, 1]) | (self.owner[1:] != self.owner[:-1])
        runs = np.split(np.arange(len(self.pairs)), np.flatnonzero(ends) + 1)
        return [
            (int(self.owner[run[0]]), self.points_mm[[*self.pairs[run, 0], self.pairs[run[-1], 1]]])
            for run in runs
            if len(run)
        ]


class Feature(Displayable, Table):
    """Base class of all tables of features.

    A step of matching computes the table; it has a file format and a drawing. `READ_FIRST` names
    the scalar columns that a short table shows.
    """

    READ_FIRST: ClassVar[tuple[str, ...]] = ()

    def summary(self) -> str:
        """One sentence with the number of features."""
        return f"{len(self)} {self.IN_WORDS}."

    def record(self) -> dict[str, Any]:
        """Numbers that describe the whole table, ready for JSON."""
        return {}

    def segments_of(self, row: int | np.integer) -> dict[str, Int[np.ndarray, "_"]]:
        """Indices of the segments that show one feature, per view; empty if unknown.

        The table has this information if it has `views` and the columns `view`, `segment` and the
        number of the feature, with one row per segment. The last column has the singular name of
        the kind, for example `rim`.
        """
        table: Any = self
        numbers = getattr(table, self.KIND.removesuffix("s"), None)
        if numbers is None:
            return {}
        return {
            name: table.segment[(numbers == row) & (table.view == k)]
            for k, name in enumerate(table.views)
        }

    @abc.abstractmethod
    def wires(self) -> Wires:
        """Line drawing of all features in the world frame: points, straight lines and faces."""


def wires_of_lines(lines: Sequence[Sequence[Float[np.ndarray, "_ 3"]]]) -> Wires:
    """Line drawing of features that consist of several polylines each."""
    owners = [row for row, polylines in enumerate(lines) for _ in polylines]
    all_lines = [line for polylines in lines for line in polylines]
    points = np.concatenate([np.zeros((0, 3)), *all_lines])
    count = np.array([len(line) for line in all_lines], dtype=np.int64)
    first = np.ones(len(points), dtype=bool)
    first[np.cumsum(count) - 1] = False
    start = np.flatnonzero(first)
    owner = np.repeat(np.array(owners, dtype=np.int64), count)
    return Wires(points, np.stack([start, start + 1], axis=1), owner[start])
