"""Right circular cylinders in space, and the segments that are their outlines."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.features import Feature, Wires, wires_of_lines
from trinoc.match.tracks.matches import EVEN, Matches
from trinoc.numerics.tables import (
    COVARIANCE,
    IN_SCENE,
    PROBABILITY,
    RADIUS,
    SEGMENT_NUMBER,
    Column,
    ColumnCheck,
    check_number,
)
from trinoc.numerics.vectors import complete_axes

_ENDS = ("x1_mm", "y1_mm", "z1_mm", "x2_mm", "y2_mm", "z2_mm")
# numerical: lines along each that are drawn.
_RULINGS = 4


class Cylinders(Feature):
    """Cylinders, each from its outlines in two views or more.

    `cylinder`, `view`, `segment` and `side` are one table with a row for each outline's segment.

    Fields
    ------
    views : names of the views, the order of their numbers.
    axis_mm : (c, 2, 3) ends of each axis, in the world frame: as far as two outlines reach.
    radius_mm : (c,)
    covariance_mm2 : (c, 7, 7) of both ends and the radius. Along the axis, ends are where
        detectors stopped.
    posterior : (c,) probability that the outlines are those of one cylinder.
    rival_posterior : (c,) posterior of the best other cylinder that shares an outline and was
        excluded; 0 where none.
    chi_square, degrees : (c,) misfit of all outlines under their stated covariance, and its
        degrees of freedom.
    cylinder, view, segment : (m,) number of the cylinder, of the view, and of the segment there.
    side : (m,) side of the axis on which the outline passes: 1 or -1, for all views alike.
    silhouette : (t,) probability that each track of the matches holds an outline, and so is no
        line in space.
    counts : what each step of the search produced and rejected, by name.
    """

    KIND: ClassVar[str] = "cylinders"
    IN_WORDS: ClassVar[str] = "cylinders"
    SIDES: ClassVar[Mapping[str, str]] = {
        "c": "cylinders",
        "m": "outlines",
        "t": "tracks",
        "v": "views",
    }
    READ_FIRST: ClassVar[tuple[str, ...]] = ("radius_mm", "posterior")
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {"radius_sigma_mm": ()}

    views: Annotated[tuple[str, ...], Column(side="v")] = eqx.field(static=True)
    axis_mm: Annotated[Float[np.ndarray, "c 2 3"], Column(IN_SCENE, parts=_ENDS)]
    radius_mm: Annotated[Float[np.ndarray, "c"], Column(RADIUS)]
    covariance_mm2: Annotated[
        Float[np.ndarray, "c 7 7"], Column(COVARIANCE, parts=(*_ENDS, "radius_mm"))
    ]
    posterior: Annotated[Float[np.ndarray, "c"], Column(PROBABILITY)]
    rival_posterior: Annotated[Float[np.ndarray, "c"], Column(PROBABILITY)]
    chi_square: Float[np.ndarray, "c"]
    degrees: Int[np.ndarray, "c"]
    cylinder: Annotated[Int[np.ndarray, "m"], Column(check_number("c", "is no cylinder"))]
    view: Annotated[Int[np.ndarray, "m"], Column(check_number("v", "is no view"))]
    segment: Annotated[Int[np.ndarray, "m"], Column(SEGMENT_NUMBER)]
    side: Annotated[
        Int[np.ndarray, "m"],
        Column(ColumnCheck("is no side", lambda side, _: np.abs(side) == 1)),
    ]
    silhouette: Annotated[Float[np.ndarray, "t"], Column(PROBABILITY)]
    counts: dict[str, int]

    def mark(self, matches: Matches) -> Matches:
        """The matches that the cylinders were found in, with the mark "silhouette"."""
        return matches.with_marks(silhouette=self.silhouette)

    def of_tracks(self, kept: Int[np.ndarray, "k"], count: int) -> "Cylinders":
        """The same for matches that begin with the tracks `kept` of these, of `count` tracks."""
        more = np.zeros(count - len(kept))
        return dataclasses.replace(self, silhouette=np.append(self.silhouette[kept], more))

    @property
    def radius_sigma_mm(self) -> Float[np.ndarray, "c"]:
        """(c,) standard deviation of each radius."""
        return np.sqrt(self.covariance_mm2[:, 6, 6])

    def summary(self) -> str:
        """How many there are, and on how many tracks."""
        marked = int((self.silhouette > EVEN).sum())
        found = "1 cylinder" if len(self) == 1 else f"{len(self)} cylinders"
        return f"{found}; {marked} tracks hold an outline of one."

    def record(self) -> dict[str, Any]:
        """How many tracks are marked, and the counts."""
        return {"tracks_marked": int((self.silhouette > EVEN).sum()), "counts": self.counts}

    def circles_mm(self, sides: int = 48) -> Float[np.ndarray, "c 2 n 3"]:
        """(c, 2, sides, 3) points round both ends of each cylinder, opposite each other."""
        way = self.axis_mm[:, 1] - self.axis_mm[:, 0]
        length = np.linalg.norm(way, axis=1, keepdims=True)
        across = complete_axes(way / np.maximum(length, np.finfo(float).tiny))
        angle = np.arange(sides) * (2 * np.pi / sides)
        circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        around = self.radius_mm[:, None, None] * (circle @ across)
        return self.axis_mm[:, :, None] + around[:, None]

    def wires(self) -> Wires:
        """Both circles of each, closed, and lines along it."""
        circles = self.circles_mm()
        closed = np.concatenate([circles, circles[:, :, :1]], axis=2)
        along = circles[:, :, :: circles.shape[2] // _RULINGS].swapaxes(1, 2)
        return wires_of_lines([[*rims, *lines] for rims, lines in zip(closed, along, strict=True)])
