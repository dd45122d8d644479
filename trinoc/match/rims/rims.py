"""Result type of the rims: circles in space, their chords, and the matches with them."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.geometry.features import Feature, Wires, wires_of_lines
from trinoc.match.rims.circles import Circles, points_on_circles
from trinoc.match.tracks.matches import Matches
from trinoc.numerics.tables import (
    COVARIANCE,
    IN_SCENE,
    RADIUS,
    SEGMENT_NUMBER,
    Column,
    ColumnCheck,
    check_index,
)

_CENTRE, _NORMAL = ("x_mm", "y_mm", "z_mm"), ("normal_x", "normal_y", "normal_z")
# numerical: rounding error of the length of a normal, and of a share.
_ROUNDING, _SHARE_ROUNDING = 1e-6, 1e-9


class Rims(Feature):
    """Circles in space, each fitted to its chords in two or more views.

    `rim`, `view` and `segment` form one table with a row for each chord.

    Attributes
    ----------
    views : tuple of str
        Names of the views. `view` contains indices of this tuple.
    centre_mm : (c, 3)
        Centres, world frame.
    normal : (c, 3)
        Unit normals of the planes of the circles.
    radius_mm : (c,)
        Radii.
    covariance_mm2 : (c, 7, 7)
        Covariance of centre, normal (no unit) and radius.
    covered : (c,)
        Share of each circle on which two or more views have chords.
    rim, view, segment : (m,)
        Index of the rim, index of the view, and index of the segment in that view.
    matches : Matches
        The tracks that no rim explains, followed by pieces of the rims. Each piece is a chord of
        its circle in space. The fragments of a piece are parts of segments. The covariance of these
        fragments includes the distance between chord and arc. Tracks with an outline of the body
        below a rim have the mark "silhouette".
    kept : (k,)
        Indices that the first k tracks of `matches` had before the rims were added.
    counts : dict of int
        Numbers of circles and tracks that each step produced and rejected, by name.
    """

    KIND: ClassVar[str] = "rims"
    IN_WORDS: ClassVar[str] = "rims"
    SIDES: ClassVar[Mapping[str, str]] = {
        "c": "rims",
        "m": "chords",
        "k": "tracks",
        "v": "views",
    }
    READ_FIRST: ClassVar[tuple[str, ...]] = ("radius_mm", "covered")
    DERIVED: ClassVar[Mapping[str, Sequence[str]]] = {"radius_sigma_mm": ()}

    views: Annotated[
        tuple[str, ...],
        Column(
            ColumnCheck(
                "are not those of the matches",
                lambda views, table: views == table.values["matches"].views,
            ),
            side="v",
        ),
    ] = eqx.field(static=True)
    centre_mm: Annotated[Float[np.ndarray, "c 3"], Column(IN_SCENE, parts=_CENTRE)]
    normal: Annotated[
        Float[np.ndarray, "c 3"],
        Column(
            ColumnCheck(
                "is no unit vector",
                lambda normal, _: np.abs(np.linalg.norm(normal, axis=1) - 1) < _ROUNDING,
            ),
            parts=_NORMAL,
        ),
    ]
    radius_mm: Annotated[Float[np.ndarray, "c"], Column(RADIUS)]
    covariance_mm2: Annotated[
        Float[np.ndarray, "c 7 7"], Column(COVARIANCE, parts=(*_CENTRE, *_NORMAL, "radius_mm"))
    ]
    covered: Annotated[
        Float[np.ndarray, "c"],
        Column(
            ColumnCheck(
                "is no share", lambda share, _: (share >= 0) & (share <= 1 + _SHARE_ROUNDING)
            )
        ),
    ]
    rim: Annotated[Int[np.ndarray, "m"], Column(check_index("c", "is no rim"))]
    view: Annotated[Int[np.ndarray, "m"], Column(check_index("v", "is no view"))]
    segment: Annotated[Int[np.ndarray, "m"], Column(SEGMENT_NUMBER)]
    matches: Matches
    kept: Annotated[
        Int[np.ndarray, "k"],
        Column(
            ColumnCheck(
                "is no track",
                lambda kept, table: (kept >= 0) & (len(kept) <= len(table.values["matches"])),
            )
        ),
    ]
    counts: dict[str, int]

    @property
    def radius_sigma_mm(self) -> Float[np.ndarray, "c"]:
        """Standard deviation of each radius, (c,) mm."""
        return np.sqrt(self.covariance_mm2[:, 6, 6])

    def summary(self) -> str:
        """Return the number of rims as a sentence."""
        count = "1 rim" if len(self) == 1 else f"{len(self)} rims"
        return f"{count} of round bodies, in pieces after the other tracks."

    def record(self) -> dict[str, Any]:
        """Return the counts for the record of a run."""
        return {"counts": self.counts}

    def circles_mm(self, sides: int = 48) -> Float[np.ndarray, "c n 3"]:
        """Return points on each circle at equal angles, (c, sides, 3) mm."""
        angle = np.tile(np.arange(sides) * (2 * np.pi / sides), (len(self), 1))
        return points_on_circles(Circles(self.centre_mm, self.normal, self.radius_mm), angle)

    def wires(self) -> Wires:
        """Return each circle as a closed polygon for drawing."""
        circles = self.circles_mm()
        return wires_of_lines([[np.concatenate([circle, circle[:1]])] for circle in circles])
