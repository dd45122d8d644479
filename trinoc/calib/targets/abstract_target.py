"""What every board has in common: labelled places on the plane Z = 0 that a detector finds."""

import abc
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from equinox import AbstractVar
from jaxtyping import Float

from trinoc.numerics.values import Value

# What to give where a board is wanted.
A_BOARD = "a Pattern, Chessboard, Charuco, AprilGrid or BoardSet"


class AbstractTarget(Value):
    """Places that a detector labels: centres of circles, or corners.

    Seen from the printed side, X points right and Y up; Z points out of the board.

    Fields
    ------
    name : what the board is called.
    centres_mm : (n, 2) the places (X, Y).
    radius_mm : (n,) of the circle around each place; a corner is a circle of radius 0.
    places : of the class; what the places are, in words.
    """

    places: ClassVar[str] = "corners"

    name: AbstractVar[str]
    centres_mm: AbstractVar[Float[np.ndarray, "n 2"]]
    radius_mm: AbstractVar[Float[np.ndarray, "n"]]

    def __len__(self) -> int:
        return len(self.centres_mm)


class Disc(NamedTuple):
    """A filled circle of a drawing, of ink or of paper."""

    centre_mm: tuple[float, float]
    radius_mm: float
    is_ink: bool


class Polygon(NamedTuple):
    """A filled polygon of a drawing, of ink or of paper."""

    corners_mm: Float[np.ndarray, "n 2"]
    is_ink: bool


class Marks(NamedTuple):
    """What a picture identifies a board by. Two boards look alike if their marks overlap.

    Fields
    ------
    family : boards of different families never look alike.
    numbers : of the markers in the family.
    likeness : what two boards of overlapping marks have in common and what to do about it;
        "{numbers}" stands for the numbers that both have.
    """

    family: str
    numbers: range
    likeness: str

    def likeness_to(self, other: "Marks") -> str | None:
        """Why a picture cannot tell this board from another, and what to do; None if it can."""
        first = max(self.numbers.start, other.numbers.start)
        last = min(self.numbers.stop, other.numbers.stop) - 1
        if self.family != other.family or last < first:
            return None
        numbers = f"s {first} to {last}" if last > first else f" {first}"
        return self.likeness.format(numbers=numbers)


class AbstractBoard(AbstractTarget):
    """A printed board. A new kind is a class in this room (`BOARDS`) and a detector.

    Class fields
    ------------
    kind : the word for it in layout files and in commands.
    layout : for each key of a layout file the field that it holds, a number, a truth or a text.
    added_keys : those keys that files of earlier versions lack; the class has defaults for them.
    """

    kind: ClassVar[str]
    layout: ClassVar[Mapping[str, str]] = {}
    added_keys: ClassVar[tuple[str, ...]] = ()

    @property
    @abc.abstractmethod
    def marks(self) -> Marks:
        """What a picture identifies the board by."""

    @abc.abstractmethod
    def drawing(self) -> Sequence[Disc | Polygon]:
        """Ink and, over it, paper, in the order of painting."""
