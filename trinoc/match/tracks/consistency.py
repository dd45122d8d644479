"""Whether all segments of a track can be one line: its misfit against its degrees of freedom.

Triples that share segments two by two chain to tracks whose ends no longer agree. So the whole
track is tested, and what does not fit is split off, the worst first.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from trinoc.match.observations import MatchInput
from trinoc.match.tracks.line_fit import lines_in_space
from trinoc.numerics import chi_square_limit, chi_square_tail


class FittedTracks(NamedTuple):
    """Tracks with their lines: segments of each view, common part, ends, covariance, misfit."""

    index: Int[np.ndarray, "t v"]
    common_mm: Float[np.ndarray, "t 2 3"]
    ends_mm: Float[np.ndarray, "t 2 3"]
    covariance_mm2: Float[np.ndarray, "t 6 6"]
    misfit: Float[np.ndarray, "t"]


def fitted(
    seen: MatchInput, index: Int[np.ndarray, "t v"], common_mm: Float[np.ndarray, "t 2 3"]
) -> FittedTracks:
    """The lines of these tracks."""
    return FittedTracks(index, common_mm, *lines_in_space(seen, index, common_mm))


def consistent(tracks: FittedTracks, gate: float) -> Bool[np.ndarray, "t"]:
    """Whether tracks misfit no more than as likely as a triple passes the gate (chi-square of 2
    degrees of freedom)."""
    degrees = 2 * ((tracks.index >= 0).sum(axis=1) - 2)
    limit = chi_square_limit(chi_square_tail(gate, 2), np.maximum(degrees, 1))
    return (tracks.misfit <= np.where(degrees > 0, limit, np.inf)) & np.isfinite(tracks.misfit)


def without_misfits(seen: MatchInput, tracks: FittedTracks, gate: float) -> FittedTracks:
    """Tracks that are consistent, or made so by leaving out the views that fit worst; rows of
    those that even three views do not agree on hold no view."""
    index = tracks.index.copy()
    now = tracks
    while True:
        bad = np.flatnonzero(~consistent(now, gate))
        views = (index[bad] >= 0).sum(axis=1)
        index[bad[views <= 3]] = -1
        bad = bad[views > 3]
        if len(bad) == 0:
            return now._replace(index=index)
        owner, view = np.nonzero(index[bad] >= 0)
        trial = index[bad][owner]
        trial[np.arange(len(owner)), view] = -1
        misfit = np.nan_to_num(fitted(seen, trial, now.common_mm[bad][owner]).misfit, nan=np.inf)
        best = np.lexsort((misfit, owner))
        best = best[np.unique(owner[best], return_index=True)[1]]
        index[bad] = trial[best]
        again = fitted(seen, index[bad], now.common_mm[bad])
        columns = [column.copy() for column in now]
        for column, new in zip(columns, again, strict=True):
            column[bad] = new
        now = FittedTracks(*columns)
