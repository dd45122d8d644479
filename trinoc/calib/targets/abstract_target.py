"""Base classes of boards: a board is a set of numbered points on the plane Z = 0, with its ink."""

import abc
from collections.abc import Mapping, Sequence
from typing import ClassVar, NamedTuple

import numpy as np
from equinox import AbstractVar
from jaxtyping import Float

from trinoc.numerics.values import Value

# Completes messages of the form "... give a Pattern, ..." about an argument of the wrong type.
A_BOARD = "a Pattern, Chessboard, Charuco, AprilGrid or BoardSet"


class AbstractTarget(Value):
    """A board or a set of boards: labelled points that a detector can locate in an image.

    A point is the centre of a circle or a corner, on a flat board. Its label is its index in
    `centres_mm`. Seen from the printed side, X points right and Y up; Z points out of the board.

    Attributes
    ----------
    name : name of the board, used in messages and files.
    centres_mm : (n, 2) positions (X, Y) of the points in the board's frame.
    radius_mm : (n,) radius of the circle around each point; 0 for a corner.
    point_kind : "circles" or "corners", the same for all boards of a class.
    """

    point_kind: ClassVar[str] = "corners"

    name: AbstractVar[str]
    centres_mm: AbstractVar[Float[np.ndarray, "n 2"]]
    radius_mm: AbstractVar[Float[np.ndarray, "n"]]

    def __len__(self) -> int:
        return len(self.centres_mm)


class Disc(NamedTuple):
    """Filled circle of a drawing.

    Attributes
    ----------
    centre_mm : centre (X, Y).
    radius_mm : radius.
    is_ink : True for ink; False for the colour of the paper.
    """

    centre_mm: tuple[float, float]
    radius_mm: float
    is_ink: bool


class Polygon(NamedTuple):
    """Filled polygon of a drawing.

    Attributes
    ----------
    corners_mm : (n, 2) corners (X, Y) in order.
    is_ink : True for ink; False for the colour of the paper.
    """

    corners_mm: Float[np.ndarray, "n 2"]
    is_ink: bool


class Marks(NamedTuple):
    """Features of a board that distinguish it from other boards in an image.

    An image cannot distinguish two boards of the same family whose ranges of marker ids overlap.

    Attributes
    ----------
    family : name of the kind of features. Boards of different families never look alike.
    marker_ids : ids of the board's markers within the family.
    likeness : message for two boards that cannot be distinguished: the features that both have, and
        the remedy. "{numbers}" is replaced by the common ids.
    """

    family: str
    marker_ids: range
    likeness: str

    def likeness_to(self, other: "Marks") -> str | None:
        """Return a message if an image cannot distinguish this board from another; else None.

        The message names the features that both boards have.

        Parameters
        ----------
        other : features of the other board.
        """
        first = max(self.marker_ids.start, other.marker_ids.start)
        last = min(self.marker_ids.stop, other.marker_ids.stop) - 1
        if self.family != other.family or last < first:
            return None
        numbers = f"s {first} to {last}" if last > first else f" {first}"
        return self.likeness.format(numbers=numbers)


class AbstractBoard(AbstractTarget):
    """A single printed board.

    To add a kind of board, write a class in this package, list it in `board_set.BOARDS`, and
    register its detector in `trinoc.calib.detection.registry`.

    Attributes
    ----------
    kind : name of the kind in layout files and on the command line.
    layout : field of the class for each key of a layout file; its value is a number, boolean or
        string.
    added_keys : keys of `layout` that are missing in files of earlier versions; their fields have
        default values.
    """

    kind: ClassVar[str]
    layout: ClassVar[Mapping[str, str]] = {}
    added_keys: ClassVar[tuple[str, ...]] = ()

    @property
    @abc.abstractmethod
    def marks(self) -> Marks:
        """Features that distinguish the board from other boards in an image."""

    @abc.abstractmethod
    def drawing(self) -> Sequence[Disc | Polygon]:
        """Shapes of ink and of paper colour, in painting order."""
