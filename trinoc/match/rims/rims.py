"""Rims in space, the segments that are their chords, and the matches with them."""

import equinox as eqx
import numpy as np
from jaxtyping import Float, Int

from trinoc.match.rims.circles import Circles, points_at
from trinoc.match.tracks import Matches


class Rims(eqx.Module):
    """Circles, each from its chords in two views or more.

    `rim`, `view` and `segment` are one table with a row for each chord.

    Fields
    ------
    views : names of the views, the order of their numbers.
    centre_mm : (c, 3), in the world frame. normal : (c, 3) unit vectors across their planes.
    radius_mm : (c,)
    covariance_mm2 : (c, 7, 7) of centre, normal (no unit) and radius.
    covered : (c,) share of each circle that chords of two views show.
    rim, view, segment : (m,) number of the rim, of the view, and of the segment there.
    matches : the given matches without the tracks that rims explain, and after them pieces of the
        rims, each a chord of its circle. A fragment is the segment's part abreast of it, and its
        covariance holds how far the segment bows. Tracks that hold an outline of the body below a
        rim are marked by `silhouette`.
    kept : (k,) the numbers that the first k tracks had before.
    counts : what each step of the search produced, by name.
    """

    views: tuple[str, ...] = eqx.field(static=True)
    centre_mm: Float[np.ndarray, "c 3"]
    normal: Float[np.ndarray, "c 3"]
    radius_mm: Float[np.ndarray, "c"]
    covariance_mm2: Float[np.ndarray, "c 7 7"]
    covered: Float[np.ndarray, "c"]
    rim: Int[np.ndarray, "m"]
    view: Int[np.ndarray, "m"]
    segment: Int[np.ndarray, "m"]
    matches: Matches
    kept: Int[np.ndarray, "k"]
    counts: dict[str, int]

    def __len__(self) -> int:
        return len(self.radius_mm)

    @property
    def radius_sigma_mm(self) -> Float[np.ndarray, "c"]:
        """(c,) standard deviation of each radius."""
        return np.sqrt(self.covariance_mm2[:, 6, 6])

    def chords_of(self, rim: int | np.integer) -> dict[str, Int[np.ndarray, "_"]]:
        """The segments of each view that are chords of a rim."""
        own = self.rim == rim
        return {name: self.segment[own & (self.view == k)] for k, name in enumerate(self.views)}

    def circles_mm(self, sides: int = 48) -> Float[np.ndarray, "c n 3"]:
        """(c, sides, 3) points round each."""
        angle = np.tile(np.arange(sides) * (2 * np.pi / sides), (len(self), 1))
        return points_at(Circles(self.centre_mm, self.normal, self.radius_mm), angle)
