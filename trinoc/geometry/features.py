"""Features in space: tables of things that are found there, and how they are drawn as lines."""

import abc
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.display import Displayable
from trinoc.numerics.tables import Table


class Wires(NamedTuple):
    """Drawing of features: points, straight lines between pairs of points, and faces.

    places_mm : (n, 3), in the world frame. pairs : (e, 2). indices of the two ends of each
    line. owner : (e,) index of the feature to which each line belongs. loops : for each face the
    indices of the points around it.
    """

    places_mm: Float[np.ndarray, "n 3"]
    pairs: Int[np.ndarray, "e 2"]
    owner: Int[np.ndarray, "e"]
    loops: Sequence[Int[np.ndarray, "_"]] = ()

    def lines(self) -> list[tuple[int, Float[np.ndarray, "_ 3"]]]:
        """(owner, points) of each line from point to point, as long as pairs go on."""
        ends = (self.pairs[1:, 0] != self.pairs[:-1, 1]) | (self.owner[1:] != self.owner[:-1])
        runs = np.split(np.arange(len(self.pairs)), np.flatnonzero(ends) + 1)
        return [
            (int(self.owner[run[0]]), self.places_mm[[*self.pairs[run, 0], self.pairs[run[-1], 1]]])
            for run in runs
            if len(run)
        ]


class Feature(Displayable, Table):
    """A kind of feature. It is found by a step of matching, has a file of its own, and is drawn.

    `READ_FIRST` are the columns, a number for each, that people read first.
    """

    READ_FIRST: ClassVar[tuple[str, ...]] = ()

    def summary(self) -> str:
        """What was found, in a sentence."""
        return f"{len(self)} {self.IN_WORDS}."

    def record(self) -> dict[str, Any]:
        """Numbers of the whole, as JSON holds them."""
        return {}

    def segments_of(self, row: int | np.integer) -> dict[str, Int[np.ndarray, "_"]]:
        """The segments of each view that show a feature; empty where that is not known.

        A kind knows it that has `views`, and a row for each segment of `view`, `segment` and the
        number of the feature, which is named as one of the kind: `rim`.
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
        """How each feature is drawn."""


def wires_of_lines(lines: Sequence[Sequence[Float[np.ndarray, "_ 3"]]]) -> Wires:
    """The wires of features that are drawn as some lines each, from point to point."""
    owners = [row for row, own in enumerate(lines) for _ in own]
    every = [line for own in lines for line in own]
    places = np.concatenate([np.zeros((0, 3)), *every])
    count = np.array([len(line) for line in every], dtype=np.int64)
    first = np.ones(len(places), dtype=bool)
    first[np.cumsum(count) - 1] = False
    start = np.flatnonzero(first)
    owner = np.repeat(np.array(owners, dtype=np.int64), count)
    return Wires(places, np.stack([start, start + 1], axis=1), owner[start])
