"""Fragments of segments that show the same lines in several views: what refinement takes."""

import equinox as eqx
import numpy as np
from jaxtyping import Bool, Float

from trinoc.errors import InputError


class LineObservations(eqx.Module):
    """Tracks of fragments, and a first estimate of the line that each shows.

    Fields
    ------
    views : names of the views, the order of axis v.
    fragments_px : (t, v, 2, 2) corresponding ends, in pixels of the picture; anything where
        not seen.
    covariance_px2 : (t, v, 4, 4) of the fragments' ends.
    seen : (t, v) whether a view shows the line.
    lines_mm : (t, 2, 3) two points of each line, from where the refinement starts; the 3-D
        segment is reported between them.
    """

    views: tuple[str, ...] = eqx.field(static=True)
    fragments_px: Float[np.ndarray, "t v 2 2"]
    covariance_px2: Float[np.ndarray, "t v 4 4"]
    seen: Bool[np.ndarray, "t v"]
    lines_mm: Float[np.ndarray, "t 2 3"]

    def __check_init__(self) -> None:
        fewest = self.seen.sum(axis=1).min(initial=2)
        if fewest < 2:
            raise InputError(
                f"Track {int(np.argmin(self.seen.sum(axis=1)))} is seen in {fewest} view(s), but a "
                "line in space needs at least two: leave such tracks out."
            )

    def __len__(self) -> int:
        return len(self.lines_mm)

    def select(self, keep: np.ndarray) -> "LineObservations":
        """The observations of some tracks, by mask or index."""
        return type(self)(
            self.views,
            self.fragments_px[keep],
            self.covariance_px2[keep],
            self.seen[keep],
            self.lines_mm[keep],
        )
