"""Straight lines in space, each estimated from all tracks on it."""

import numpy as np
from jaxtyping import Float, Int

from trinoc.numerics.values import Value


class JoinedLines(Value):
    """Straight lines in space, each estimated from one or more collinear tracks.

    Attributes
    ----------
    lines_mm : (e, 2, 3)
        Posterior mean of the ends, world frame, given all segments of the tracks. The line extends
        from the first to the last point that a track shows.
    covariance_mm2 : (e, 6, 6)
        Covariance of both ends. Along the line, the variance of an end is that of the track that
        ends there. The covariance allows for segments with larger errors than stated, mainly if
        views disagree or only two views show the line.
    chi_square, degrees : (e,)
        Misfit of all segments and its degrees of freedom; 0 for a single track.
    line_of_track : (t,)
        Index of the line of each track.
    place_mm : (t, 2)
        Interval of each track on its line, measured from the line's first end.
    px_per_mm : (e,)
        Image displacement per mm across the viewing direction at the line's midpoint, mean over the
        views.
    posterior : (e,)
        Smallest posterior of the line's tracks.
    """

    lines_mm: Float[np.ndarray, "e 2 3"]
    covariance_mm2: Float[np.ndarray, "e 6 6"]
    chi_square: Float[np.ndarray, "e"]
    degrees: Int[np.ndarray, "e"]
    line_of_track: Int[np.ndarray, "t"]
    place_mm: Float[np.ndarray, "t 2"]
    px_per_mm: Float[np.ndarray, "e"]
    posterior: Float[np.ndarray, "e"]

    def __len__(self) -> int:
        return len(self.lines_mm)

    @property
    def pieces(self) -> Int[np.ndarray, "e"]:
        """Number of tracks of each line, (e,)."""
        return np.bincount(self.line_of_track, minlength=len(self))

    def tracks_of(self, line: int | np.integer) -> Int[np.ndarray, "_"]:
        """Return the indices of a line's tracks, sorted by position along the line."""
        tracks = np.flatnonzero(self.line_of_track == line)
        return tracks[np.argsort(self.place_mm[tracks, 0], kind="stable")]

    def gaps_mm(self, line: int | np.integer) -> Float[np.ndarray, "g 2"]:
        """Return the intervals of a line that no track shows, (g, 2) mm from its first end."""
        return _gaps(self.place_mm[self.tracks_of(line)])

    def overlaps_mm(self, line: int | np.integer) -> Float[np.ndarray, "o 2"]:
        """Return the intervals of a line that two or more tracks show, (o, 2) mm from its first
        end.
        """
        interval = self.place_mm[self.tracks_of(line)]
        end_so_far = np.maximum.accumulate(interval[:, 1])
        overlap = np.stack([interval[1:, 0], np.minimum(end_so_far[:-1], interval[1:, 1])], axis=1)
        return overlap[overlap[:, 1] > overlap[:, 0]]


def _gaps(interval: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "g 2"]:
    end_so_far = np.maximum.accumulate(interval[:, 1])
    gap = np.stack([end_so_far[:-1], interval[1:, 0]], axis=1)
    return gap[gap[:, 1] > gap[:, 0]]
