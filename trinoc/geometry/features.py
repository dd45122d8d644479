"""Features in space: base class of tables of corners, rims and others, and line drawings."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.display import Displayable
from trinoc.numerics.tables import Table


class Wires(NamedTuple):
    """Line drawing of 3-D features such as corners or rims: points, straight lines and faces.

    Attributes
    ----------
    points_mm : (n, 3)
        Points in the world frame.
    pairs : (e, 2)
        Straight lines: indices into `points_mm` of the two ends of each line.
    owner : (e,)
        Index of the feature that each line belongs to.
    loops : sequence of (k,)
        Faces: for each face, the indices into `points_mm` of its corners, in order.
    """

    points_mm: Float[np.ndarray, "n 3"]
    pairs: Int[np.ndarray, "e 2"]
    owner: Int[np.ndarray, "e"]
    loops: Sequence[Int[np.ndarray, "_"]] = ()

    def lines(self) -> list[tuple[int, Float[np.ndarray, "_ 3"]]]:
        """Join the straight lines to polylines: a list of (feature index, points (k, 3) in mm).

        Consecutive lines of one feature that share an end form one polyline.
        """
        ends = (self.pairs[1:, 0] != self.pairs[:-1, 1]) | (self.owner[1:] != self.owner[:-1])
        runs = np.split(np.arange(len(self.pairs)), np.flatnonzero(ends) + 1)
        return [
            (int(self.owner[run[0]]), self.points_mm[[*self.pairs[run, 0], self.pairs[run[-1], 1]]])
            for run in runs
            if len(run)
        ]


class Feature(Displayable, Table):
    """Base class of the tables of 3-D features: corners, rims, joined lines and others.

    One object is a table with one feature in each row. A subclass adds the columns. `READ_FIRST`
    names the scalar columns that a short printed table shows.
    """

    READ_FIRST: ClassVar[tuple[str, ...]] = ()

    def summary(self) -> str:
        """Return one sentence with the number of features."""
        return f"{len(self)} {self.IN_WORDS}."

    def record(self) -> dict[str, Any]:
        """Values that describe the whole table, for the JSON output; empty in this base class."""
        return {}

    def segments_of(self, row: int | np.integer) -> dict[str, Int[np.ndarray, "_"]]:
        """Indices of the image segments that show feature `row`, keyed by view name.

        Empty if the table does not store them. A table stores them in three columns with one row
        for each segment: `view`, `segment`, and the feature index. The last column is named after
        the kind of feature in the singular, for example `rim`.
        """
        table: Any = self
        feature_ids = getattr(table, self.KIND.removesuffix("s"), None)
        if feature_ids is None:
            return {}
        return {
            name: table.segment[(feature_ids == row) & (table.view == k)]
            for k, name in enumerate(table.views)
        }

    @abc.abstractmethod
    def wires(self) -> Wires:
        """Return the line drawing of all features: points, lines and faces in the world frame."""


def wires_of_lines(lines: Sequence[Sequence[Float[np.ndarray, "_ 3"]]]) -> Wires:
    """Line drawing of features that consist of polylines.

    `lines` has one list for each feature. The list contains the polylines of the feature, (k, 3)
    mm.
    """
    owners = [row for row, polylines in enumerate(lines) for _ in polylines]
    all_lines = [line for polylines in lines for line in polylines]
    points = np.concatenate([np.zeros((0, 3)), *all_lines])
    count = np.array([len(line) for line in all_lines], dtype=np.int64)
    first = np.ones(len(points), dtype=bool)
    first[np.cumsum(count) - 1] = False
    start = np.flatnonzero(first)
    owner = np.repeat(np.array(owners, dtype=np.int64), count)
    return Wires(points, np.stack([start, start + 1], axis=1), owner[start])
